// Turns what a person does into steps, each with the page before it: its listeners read the page before the page reacts.
// Only loaded while demonstrations are recorded. `host` says how pages are read:
//   read()               the page
//   rowOf(node, page)    the element of the page that stands for a node; the node itself where it is one
//   offsetOf(node)       where the node's document is in the outermost one, {x, y} in CSS px
//   isRecording()
//   changed()            is called when the steps may have changed
const person = (host) => {
  'use strict';

  const CLICK = 0, TYPE = 1, PRESS = 3, SCROLL = 4, DRAG = 5;  // as in giirl_core.actions.Verb
  const DRAG_PX = 5;      // a click may move the mouse this far
  const EDITING = new Set(['Backspace', 'Delete', 'ArrowLeft', 'ArrowRight', 'Home', 'End']);
  const MODIFIERS = ['Control', 'Alt', 'Meta', 'Shift'];
  const BUTTONS = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image', 'range', 'color', 'file']);

  const { setTimeout } = window;  // real time: clock.js replaces it later

  let steps = [];
  let down = null;    // where the mouse button was pressed: {page, target, x, y, scrolls, size, dragged}
  let typing = null;  // the field that is being typed into: {field, before, keys, first}
  let choosing = null;  // the list in which something is being chosen, and the page before: {select, page, selected}
  // The step that may make the browser generate a click: a click on a label, or a key. Reset once its event is handled.
  let cause = null;
  const handled = new WeakSet();  // events

  const named = (node, ...names) => names.includes(node.localName);  // instanceof fails across frames
  const targetOf = (event) => event.composedPath()[0] || event.target;  // inside an open shadow root

  function step(verb, target, more = {}) {
    const page = host.read(), row = target ? host.rowOf(target, page) : null;
    return { page, verb, target, ref: row ? reading.refOf(row) : 0, text: '', x: 0, y: 0, dx: 0, dy: 0, ...more };
  }

  function placeOf({ clientX, clientY }, target) {
    const { x, y } = host.offsetOf(target);
    return { x: x + clientX, y: y + clientY };
  }

  function middle(target) {
    const box = target.getBoundingClientRect(), { x, y } = host.offsetOf(target);
    return { x: x + box.left + box.width / 2, y: y + box.top + box.height / 2 };
  }

  const takesText = (node) => (named(node, 'input') && !BUTTONS.has(node.type) && !node.readOnly)
    || named(node, 'textarea') || node.isContentEditable === true;
  // The element that is edited: what is typed into a paragraph of an editor is typed into the editor.
  function fieldOf(node) {
    let field = node;
    while (field.isContentEditable && field.parentElement && field.parentElement.isContentEditable) {
      field = field.parentElement;
    }
    return field;
  }
  const textIn = (field) => (field.isContentEditable ? field.innerText.trim() : field.value);

  function push(one) {
    steps.push(one);
    cause = one;
    setTimeout(() => { if (cause === one) cause = null; });
  }

  // ---- typing

  // The step of the typing under way: the click that focused the field if nothing was typed, null without one.
  function typed() {
    const { field, before, keys, first } = typing;
    const { click, ...rest } = first, text = textIn(field);
    if (text === before && !keys) return click || null;
    return { ...rest, verb: TYPE, text: text || (before === '' ? keys : '') };  // a date has no value until it is whole
  }

  function endTyping() {
    if (typing === null) return;
    const one = typed();
    typing = null;
    if (one) steps.push(one);
  }

  function startTyping(target) {
    const field = fieldOf(target);
    if (typing !== null && typing.field === field) return;
    endTyping();
    // A click that only focused the field is part of the typing.
    const now = step(TYPE, field), last = steps[steps.length - 1];
    const click = last && last.verb === CLICK && now.ref && last.ref === now.ref ? steps.pop() : undefined;
    typing = { field, before: textIn(field), keys: '', first: { ...now, click, ...(click && { page: click.page }) } };
  }

  // ---- the mouse

  const selectOf = (target) => target.closest && target.closest('select');

  function scrollPositions(node) {
    const positions = [];
    for (; node; node = node.parentElement) positions.push([node, node.scrollLeft, node.scrollTop]);
    return positions;
  }

  const sizeOf = ({ offsetWidth, offsetHeight }) => `${offsetWidth} ${offsetHeight}`;

  function onMouseDown(event) {
    if (event.button !== 0) return;
    endTyping();
    const target = targetOf(event);
    down = {
      ...step(CLICK, target, placeOf(event, target)), scrolls: scrollPositions(target), size: sizeOf(target),
      dragged: false,
    };
    if (selectOf(target)) startChoosing(selectOf(target), down.page);
  }

  function onMouseUp(event) {
    if (down === null) return;
    const { page, ref, x, y, target } = down, to = placeOf(event, targetOf(event));
    if (Math.hypot(to.x - x, to.y - y) <= DRAG_PX || selectOf(target)) return;
    if (takesText(target) && sizeOf(target) === down.size) return;  // selects text that will be copied or replaced
    down.dragged = true;
    const scrolled = down.scrolls.find(([node, left, top]) => node.scrollLeft !== left || node.scrollTop !== top);
    if (scrolled) {
      const [node, left, top] = scrolled;
      pushScroll(node, page, node.scrollLeft - left, node.scrollTop - top);
    } else {
      push({ ...step(DRAG, null), page, target, ref, x, y, dx: to.x - x, dy: to.y - y });
    }
  }

  function onClick(event) {
    const target = targetOf(event);
    if (selectOf(target)) return;  // recorded by its change event
    const last = steps[steps.length - 1];
    const fromLabel = cause !== null && cause.verb === CLICK && target.labels
      && [...target.labels].some((label) => label.contains(cause.target));
    if (fromLabel || event.detail === 0) {
      // The browser generated this click for a label or a key: record it as a click on its own target, if that is seen.
      const isSpace = last && last.verb === PRESS && last.text === ' ';  // the space bar clicks when it is released
      const origin = isSpace ? last : cause;
      if (origin !== null && host.rowOf(target, origin.page) !== target) return;
      const change = { verb: CLICK, target, ref: reading.refOf(target), text: '', ...middle(target) };
      if (origin !== null) Object.assign(origin, change);
      else push({ ...step(CLICK, target), ...middle(target) });
    } else if (down !== null && !down.dragged) {
      const { page, x, y } = down;
      push({ ...step(CLICK, target, { x, y }), page });
    }
  }

  function startChoosing(select, page, selected = select.selectedOptions) {
    choosing = { select, page, selected: new Set(selected) };
  }

  function onChange(event) {
    const target = targetOf(event);
    if (!named(target, 'select')) return;
    endTyping();
    if (choosing === null || choosing.select !== target) startChoosing(target, host.read(), []);
    const { page, selected } = choosing;
    for (const option of target.options) {
      const clicked = target.multiple ? option.selected !== selected.has(option) : option.selected;
      if (clicked) push({ ...step(CLICK, option), page });
    }
    startChoosing(target, host.read());
  }

  // Only in text areas: elsewhere scrolling is not needed, since actions reach elements that are out of view.
  function onWheel(event) {
    const target = targetOf(event), field = target.closest && target.closest('textarea');
    if (!field) return;
    endTyping();
    pushScroll(field, host.read(), event.deltaX, event.deltaY);
  }

  function pushScroll(node, page, dx, dy) {
    const one = { ...step(SCROLL, node, { dx, dy }), page, ...middle(node) }, last = steps[steps.length - 1];
    if (last && last.verb === SCROLL && last.ref === one.ref) Object.assign(last, { dx: last.dx + dx, dy: last.dy + dy });
    else steps.push(one);
  }

  // ---- the keyboard

  function onKeyDown(event) {
    const { key } = event, target = targetOf(event);
    if (named(target, 'select')) startChoosing(target, host.read());
    if (MODIFIERS.includes(key) || key === 'Tab' || key === 'CapsLock' || named(target, 'select')) return;
    const held = MODIFIERS.filter((name) => event.getModifierState(name) && (name !== 'Shift' || key.length > 1));
    const isCommand = held.some((name) => name !== 'Shift');
    if (takesText(target)) {
      const isNewline = key === 'Enter' && !named(target, 'input');
      if (isCommand && 'acvx'.includes(key.toLowerCase())) return;  // recorded by the change to the field's text
      if (!isCommand && (key.length === 1 || EDITING.has(key) || isNewline)) {
        startTyping(target);
        if (key.length === 1) typing.keys += key;
        if (key === 'Backspace') typing.keys = typing.keys.slice(0, -1);
        return;
      }
    } else if (isCommand && key.toLowerCase() === 'c') {
      return;
    }
    endTyping();
    push(step(PRESS, named(target, 'body') ? null : target, { text: [...held, key].join('+') }));
  }

  function onBeforeInput(event) {
    if (takesText(targetOf(event))) startTyping(targetOf(event));
  }

  // ----

  const listeners = {
    mousedown: onMouseDown, mouseup: onMouseUp, click: onClick, change: onChange, wheel: onWheel,
    keydown: onKeyDown, beforeinput: onBeforeInput, input: () => {},
  };

  // Listen to the events of a window. A window that is listened to twice reports each event once.
  function listen(view) {
    for (const [name, listener] of Object.entries(listeners)) {
      view.addEventListener(name, (event) => {
        if (!event.isTrusted || handled.has(event) || !host.isRecording()) return;
        handled.add(event);
        listener(event);
        host.changed();
      }, { capture: true, passive: true });
    }
  }

  // All steps so far, with that of the typing under way; in typing order, so that the last one may still change.
  function soFar() {
    const last = typing === null ? null : typed();
    return last ? [...steps, last] : steps;
  }

  // The steps that were completed since the last call; at the end also those that are not.
  function take(atEnd) {
    if (atEnd) endTyping();
    const taken = atEnd ? steps : steps.slice(0, -1);  // the last one may still change
    steps = steps.slice(taken.length);
    return taken;
  }

  return { listen, soFar, take };
};
