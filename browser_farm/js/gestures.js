// Mouse actions, as the DOM events that a browser would dispatch for them. Runs before page.js.
const gestures = (() => {
  'use strict';

  // As in giirl_core.actions.Verb; WAIT (11) does nothing here.
  const CLICK = 0, TYPE = 1, APPEND = 2, PRESS = 3, SCROLL = 4, DRAG = 5, HOVER = 6, DOUBLE_CLICK = 7,
    MOUSE_DOWN = 8, MOUSE_UP = 9, ACTIVATE = 10;
  const DRAG_MOVES = 6;   // sortable lists react to every move
  const CORNER_PX = 16;   // size of the resize handle of a text area

  let hovered = null;
  let held = null;  // where the mouse button was pressed: {target, x, y, range, corner}

  function dispatchMouse(target, name, x, y, buttons, bubbles = true, detail = 0) {
    const EventType = name.startsWith('pointer') ? PointerEvent : MouseEvent;
    return target.dispatchEvent(new EventType(name, {
      bubbles, cancelable: bubbles, composed: true, view: window, detail,
      clientX: x, clientY: y, screenX: x, screenY: y, button: 0, buttons, pointerId: 1, isPrimary: true,
    }));
  }

  function hover(element, x, y) {
    const buttons = held ? 1 : 0;
    if (hovered && hovered !== element && hovered.isConnected) {
      dispatchMouse(hovered, 'mouseout', x, y, buttons);
      dispatchMouse(hovered, 'mouseleave', x, y, buttons, false);
    }
    if (hovered !== element) {
      dispatchMouse(element, 'pointerover', x, y, buttons);
      dispatchMouse(element, 'mouseover', x, y, buttons);
      dispatchMouse(element, 'mouseenter', x, y, buttons, false);
    }
    hovered = element;
    dispatchMouse(element, 'pointermove', x, y, buttons);
    dispatchMouse(element, 'mousemove', x, y, buttons);
  }

  function focusNearest(element) {
    for (let node = element; node && node !== document.body; node = node.parentElement) {
      // Testing whether an element takes the focus costs a layout: try only those that can.
      if (node.tabIndex < 0 && !node.hasAttribute('tabindex') && !node.isContentEditable) continue;
      node.focus({ preventScroll: true });
      if (document.activeElement === node) return;
    }
    if (document.activeElement && document.activeElement !== document.body) document.activeElement.blur();
  }

  function press(target, x, y, detail = 1) {
    hover(target, x, y);
    held = { target, x, y, range: null, corner: null };
    dispatchMouse(target, 'pointerdown', x, y, 1);
    if (!dispatchMouse(target, 'mousedown', x, y, 1, true, detail)) return;
    focusNearest(target);
    const box = target.getBoundingClientRect();
    if (target instanceof HTMLTextAreaElement && box.right - x < CORNER_PX && box.bottom - y < CORNER_PX) {
      held.corner = { width: box.width, height: box.height };
    }
  }

  function release(target, x, y, detail = 1) {
    const down = held;
    held = null;
    dispatchMouse(target, 'pointerup', x, y, 0);
    dispatchMouse(target, 'mouseup', x, y, 0, true, detail);
    if (!down || !down.target.isConnected) return;
    // The click goes to the nearest common ancestor of the pressed and the released element.
    let common = down.target;
    while (common && !common.contains(target)) common = common.parentElement;
    if (common) dispatchMouse(common, 'click', x, y, 0, true, detail);
  }

  function click(target, x, y) {
    if (target.closest(':disabled')) return;
    if (target instanceof HTMLOptionElement) {
      selectOption(target);
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
    dispatchMouse(target, 'dblclick', x, y, 0, true, 2);
  }

  function selectOption(option) {
    const select = option.closest('select');
    if (!select || option.closest(':disabled')) return;
    select.focus({ preventScroll: true });
    if (select.multiple) option.selected = !option.selected;  // as in WebDriver: no modifier key is needed to add one
    else select.selectedIndex = option.index;
    select.dispatchEvent(new Event('input', { bubbles: true }));
    select.dispatchEvent(new Event('change', { bubbles: true }));
    dispatchMouse(option, 'click', 0, 0, 0);
  }

  // ---- with the button held

  function move(x, y) {
    hover(elementAt(x, y), x, y);
    if (!held) return;
    if (held.corner) {
      held.target.style.width = `${held.corner.width + x - held.x}px`;
      held.target.style.height = `${held.corner.height + y - held.y}px`;
    } else {
      selectText(x, y);
    }
  }

  // Select text from where the button was pressed, unless the page prevents it.
  function selectText(x, y) {
    if (held.range === null) {
      const allowed = held.target.dispatchEvent(new Event('selectstart', { bubbles: true, cancelable: true }));
      held.range = allowed && getComputedStyle(held.target).userSelect !== 'none'
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
      const fraction = step / DRAG_MOVES;
      move(from.x + fraction * (to.x - from.x), from.y + fraction * (to.y - from.y));
    }
    release(elementAt(to.x, to.y), to.x, to.y);
  }

  function scroll(target, x, y, by) {
    const notPrevented = target.dispatchEvent(new WheelEvent('wheel', {
      bubbles: true, cancelable: true, composed: true, view: window,
      clientX: x, clientY: y, deltaX: by.x, deltaY: by.y,
    }));
    for (let node = notPrevented ? target : null; node; node = node.parentElement) {
      const { scrollLeft, scrollTop } = node;
      node.scrollBy({ left: by.x, top: by.y, behavior: 'instant' });
      if (node.scrollLeft !== scrollLeft || node.scrollTop !== scrollTop) {
        // Chrome fires the scroll event with the next frame, and a hidden tab has no frames.
        const isRoot = node === document.scrollingElement;
        (isRoot ? document : node).dispatchEvent(new Event('scroll', { bubbles: isRoot }));
        return;
      }
    }
  }

  // ---- one action

  const elementAt = (x, y) => document.elementFromPoint(x, y) || document.body;

  function offsetFromMiddle(element, by) {
    if (!element) return by;
    const box = element.getBoundingClientRect();
    return { x: box.left + box.width / 2 + by.x, y: box.top + box.height / 2 + by.y };
  }

  const elementOf = (node) => (node && node.nodeType === 3 ? node.parentElement : node);  // of a text node: its parent

  // The page has removed the element of the action; undefined is an unknown ref, null means the page as a whole.
  const isGone = (element) => element === undefined || (element !== null && !element.isConnected);

  function act({ verb, node, text, at, by, to }) {
    const element = elementOf(node), end = elementOf(to);
    if (isGone(element) || isGone(end)) return;
    if (verb === PRESS) keyboard.press(element, text);
    else if (verb === ACTIVATE) activate(element, text);
    else if (verb === TYPE || verb === APPEND) type(element, text, verb === TYPE);
    else if (verb <= MOUSE_UP) point(verb, element, at, by, end);
  }

  const FORMATTED = new Set(['date', 'time', 'datetime-local', 'month', 'week', 'color', 'range']);

  // Scrolls an action's elements into view and returns [x, y, end x, end y] in CSS px; null if native input cannot
  // perform it.
  function aim({ verb, node, at, by, to }) {
    const element = elementOf(node), end = elementOf(to);
    if (verb >= ACTIVATE || isGone(element) || isGone(end)) return null;
    // The options of a select are not drawn in the page, and the keys for a date field depend on the locale.
    if (element instanceof HTMLOptionElement) return null;
    if (element && FORMATTED.has(element.type) && (verb === TYPE || verb === APPEND)) return null;
    const intoView = { block: 'nearest', inline: 'nearest', behavior: 'instant' };
    for (const one of [element, end]) if (one) one.scrollIntoView(intoView);
    const from = offsetFromMiddle(element, at);
    const goal = end ? offsetFromMiddle(end, by) : { x: from.x + by.x, y: from.y + by.y };
    return [from.x, from.y, goal.x, goal.y];
  }

  function point(verb, element, at, by, end) {
    const { x, y } = offsetFromMiddle(element, at);
    const target = element && at.x === 0 && at.y === 0 ? element : elementAt(x, y);
    if (verb === CLICK) click(target, x, y);
    else if (verb === DOUBLE_CLICK) doubleClick(target, x, y);
    else if (verb === SCROLL) scroll(target, x, y, by);
    else if (verb === DRAG) drag(target, { x, y }, end ? offsetFromMiddle(end, by) : { x: x + by.x, y: y + by.y });
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
      const { x, y } = offsetFromMiddle(element, { x: 0, y: 0 });
      click(element, x, y);
    }
    if (!window.top.WOB_DONE_GLOBAL) keyboard.type(element, text, clear);
  }

  // The mouse leaves the page.
  function reset() {
    if (held) release(document.body, 0, 0);
    if (hovered && hovered.isConnected) {
      dispatchMouse(hovered, 'mouseout', 0, 0, 0);
      for (let node = hovered; node; node = node.parentElement) dispatchMouse(node, 'mouseleave', 0, 0, 0, false);
    }
    hovered = null;
    getSelection().removeAllRanges();
  }

  return { act, aim, click: (element) => click(element, 0, 0), reset };
})();
