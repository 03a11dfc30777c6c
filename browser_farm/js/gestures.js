// What a person's mouse does to a page, as the events that a browser would send for it. Joined in front of page.js.
const gestures = (() => {
  'use strict';

  const CLICK = 0, TYPE = 1, APPEND = 2, PRESS = 3, SCROLL = 4, DRAG = 5, HOVER = 6, DOUBLE_CLICK = 7,
    MOUSE_DOWN = 8, MOUSE_UP = 9, ACTIVATE = 10;
  const DRAG_MOVES = 6;   // sortable lists look at every move
  const CORNER_PX = 16;   // of a text area: its size is dragged there

  let hovered = null;
  let held = null;  // where the mouse button went down: {target, x, y, range, corner}

  function mouse(target, name, x, y, buttons, bubbles = true, detail = 0) {
    const Kind = name.startsWith('pointer') ? PointerEvent : MouseEvent;
    return target.dispatchEvent(new Kind(name, {
      bubbles, cancelable: bubbles, composed: true, view: window, detail,
      clientX: x, clientY: y, screenX: x, screenY: y, button: 0, buttons, pointerId: 1, isPrimary: true,
    }));
  }

  function hover(element, x, y) {
    const buttons = held ? 1 : 0;
    if (hovered && hovered !== element && hovered.isConnected) {
      mouse(hovered, 'mouseout', x, y, buttons);
      mouse(hovered, 'mouseleave', x, y, buttons, false);
    }
    if (hovered !== element) {
      mouse(element, 'pointerover', x, y, buttons);
      mouse(element, 'mouseover', x, y, buttons);
      mouse(element, 'mouseenter', x, y, buttons, false);
    }
    hovered = element;
    mouse(element, 'pointermove', x, y, buttons);
    mouse(element, 'mousemove', x, y, buttons);
  }

  function focusNear(element) {
    for (let node = element; node && node !== document.body; node = node.parentElement) {
      // Asking Chrome whether an element takes the focus costs a layout: ask only those that may.
      if (node.tabIndex < 0 && !node.hasAttribute('tabindex') && !node.isContentEditable) continue;
      node.focus({ preventScroll: true });
      if (document.activeElement === node) return;
    }
    if (document.activeElement && document.activeElement !== document.body) document.activeElement.blur();
  }

  function press(target, x, y, detail = 1) {
    hover(target, x, y);
    held = { target, x, y, range: null, corner: null };
    mouse(target, 'pointerdown', x, y, 1);
    if (!mouse(target, 'mousedown', x, y, 1, true, detail)) return;
    focusNear(target);
    const box = target.getBoundingClientRect();
    if (target instanceof HTMLTextAreaElement && box.right - x < CORNER_PX && box.bottom - y < CORNER_PX) {
      held.corner = { width: box.width, height: box.height };
    }
  }

  function release(target, x, y, detail = 1) {
    const down = held;
    held = null;
    mouse(target, 'pointerup', x, y, 0);
    mouse(target, 'mouseup', x, y, 0, true, detail);
    if (!down || !down.target.isConnected) return;
    // What was pressed and what was let go share this much.
    let both = down.target;
    while (both && !both.contains(target)) both = both.parentElement;
    if (both) mouse(both, 'click', x, y, 0, true, detail);
  }

  function click(target, x, y) {
    if (target.closest(':disabled')) return;
    if (target instanceof HTMLOptionElement) {
      choose(target);
      return;
    }
    press(target, x, y);
    release(target, x, y);
  }

  function doubleClick(target, x, y) {
    click(target, x, y);
    if (window.top.WOB_DONE_GLOBAL || !target.isConnected) return;
    press(target, x, y, 2);
    release(target, x, y, 2);
    mouse(target, 'dblclick', x, y, 0, true, 2);
  }

  function choose(option) {
    const select = option.closest('select');
    if (!select || option.closest(':disabled')) return;
    select.focus({ preventScroll: true });
    if (select.multiple) option.selected = !option.selected;  // as WebDriver does: two can be chosen without a key
    else select.selectedIndex = option.index;
    select.dispatchEvent(new Event('input', { bubbles: true }));
    select.dispatchEvent(new Event('change', { bubbles: true }));
    mouse(option, 'click', 0, 0, 0);
  }

  // ---- with the button held

  function move(x, y) {
    hover(under(x, y), x, y);
    if (!held) return;
    if (held.corner) {
      held.target.style.width = `${held.corner.width + x - held.x}px`;
      held.target.style.height = `${held.corner.height + y - held.y}px`;
    } else {
      select(x, y);
    }
  }

  // Text is selected from where the button went down, unless the page has a use of its own for the drag.
  function select(x, y) {
    if (held.range === null) {
      const begun = held.target.dispatchEvent(new Event('selectstart', { bubbles: true, cancelable: true }));
      held.range = begun && getComputedStyle(held.target).userSelect !== 'none'
        && document.caretRangeFromPoint(held.x, held.y);
    }
    const end = held.range && held.range.startContainer.isConnected && document.caretRangeFromPoint(x, y);
    if (!end) return;
    const { startContainer, startOffset } = held.range;
    getSelection().setBaseAndExtent(startContainer, startOffset, end.startContainer, end.startOffset);
  }

  function drag(target, from, to) {
    press(target, from.x, from.y);
    for (let step = 1; step <= DRAG_MOVES; step += 1) {
      const part = step / DRAG_MOVES;
      move(from.x + part * (to.x - from.x), from.y + part * (to.y - from.y));
    }
    release(under(to.x, to.y), to.x, to.y);
  }

  function scroll(target, x, y, by) {
    const turned = target.dispatchEvent(new WheelEvent('wheel', {
      bubbles: true, cancelable: true, composed: true, view: window,
      clientX: x, clientY: y, deltaX: by.x, deltaY: by.y,
    }));
    for (let node = turned ? target : null; node; node = node.parentElement) {
      const { scrollLeft, scrollTop } = node;
      node.scrollBy({ left: by.x, top: by.y, behavior: 'instant' });
      if (node.scrollLeft !== scrollLeft || node.scrollTop !== scrollTop) {
        // Chrome tells of it with the next frame, and a hidden tab has none.
        const root = node === document.scrollingElement;
        (root ? document : node).dispatchEvent(new Event('scroll', { bubbles: root }));
        return;
      }
    }
  }

  // ---- one action

  const under = (x, y) => document.elementFromPoint(x, y) || document.body;

  function middle(element, by) {
    if (!element) return by;
    const box = element.getBoundingClientRect();
    return { x: box.left + box.width / 2 + by.x, y: box.top + box.height / 2 + by.y };
  }

  const elementOf = (node) => (node && node.nodeType === 3 ? node.parentElement : node);  // bare text is acted on through

  // A node that is gone is an action in vain; null stands for the page itself.
  function act({ verb, node, text, at, by, to }) {
    const element = elementOf(node), end = elementOf(to);
    if (element === undefined || end === undefined) return;
    if ((element && !element.isConnected) || (end && !end.isConnected)) return;
    if (verb === PRESS) keyboard.press(element, text);
    else if (verb === ACTIVATE) activate(element, text);
    else if (verb === TYPE || verb === APPEND) type(element, text, verb === TYPE);
    else if (verb <= MOUSE_UP) point(verb, element, at, by, end);
  }

  const FORMAL = new Set(['date', 'time', 'datetime-local', 'month', 'week', 'color', 'range']);

  // Where a mouse has to go for an action, brought into sight; null where no mouse or keyboard can do it.
  function aim({ verb, node, at, by, to }) {
    const element = elementOf(node), end = elementOf(to);
    if (element === undefined || end === undefined || verb === ACTIVATE || verb > ACTIVATE) return null;
    if ((element && !element.isConnected) || (end && !end.isConnected)) return null;
    // The list of a select is no part of the page, and what a date field wants typed depends on the country.
    if (element instanceof HTMLOptionElement) return null;
    if (element && FORMAL.has(element.type) && (verb === TYPE || verb === APPEND)) return null;
    for (const one of [element, end]) if (one) one.scrollIntoView({ block: 'nearest', inline: 'nearest', behavior: 'instant' });
    const from = middle(element, at);
    const goal = end ? middle(end, by) : { x: from.x + by.x, y: from.y + by.y };
    return [from.x, from.y, goal.x, goal.y];
  }

  function point(verb, element, at, by, end) {
    const { x, y } = middle(element, at);
    const target = element && at.x === 0 && at.y === 0 ? element : under(x, y);
    if (verb === CLICK) click(target, x, y);
    else if (verb === DOUBLE_CLICK) doubleClick(target, x, y);
    else if (verb === SCROLL) scroll(target, x, y, by);
    else if (verb === DRAG) drag(target, { x, y }, end ? middle(end, by) : { x: x + by.x, y: y + by.y });
    else if (verb === HOVER && held) move(x, y);
    else if (verb === HOVER) hover(target, x, y);
    else if (verb === MOUSE_DOWN) press(target, x, y);
    else if (verb === MOUSE_UP) {
      if (held) move(x, y);
      release(target, x, y);
    }
  }

  function activate(element, text) {
    if (!element) return;
    if (element instanceof SVGElement) {
      for (const name of ['mousedown', 'mouseup', 'click']) element.dispatchEvent(new Event(name));
    } else {
      element.click();
      element.focus();
    }
    if (text) keyboard.type(null, text, false);
  }

  function type(element, text, clear) {
    if (element) {
      const { x, y } = middle(element, { x: 0, y: 0 });
      click(element, x, y);
    }
    if (!window.top.WOB_DONE_GLOBAL) keyboard.type(element, text, clear);
  }

  // The mouse leaves the page, and with it all that it held and hovered over.
  function forget() {
    if (held) release(document.body, 0, 0);
    if (hovered && hovered.isConnected) {
      mouse(hovered, 'mouseout', 0, 0, 0);
      for (let node = hovered; node; node = node.parentElement) mouse(node, 'mouseleave', 0, 0, 0, false);
    }
    hovered = null;
    getSelection().removeAllRanges();
  }

  return { act, aim, click: (element) => click(element, 0, 0), forget };
})();
