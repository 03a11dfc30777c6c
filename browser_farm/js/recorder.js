// Turns what a person does to a page into steps, each with the page as it was before. Joined in front of the others,
// so that it sees the page before they do; only where somebody is being recorded.
const recorder = (() => {
  'use strict';

  const CLICK = 0, TYPE = 1, PRESS = 3, SCROLL = 4, DRAG = 5;
  const DRAG_PX = 5;      // the mouse may tremble so far in a click
  const TICK_MS = 20;
  const EDITING = new Set(['Backspace', 'Delete', 'ArrowLeft', 'ArrowRight', 'Home', 'End']);
  const MODIFIERS = ['Control', 'Alt', 'Meta', 'Shift'];
  const BUTTONS = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image', 'range', 'color', 'file']);

  const { setTimeout, Date } = window;  // a person's time, before the page's own takes their place

  let steps = [];
  let down = null;    // where the mouse button went down: {page, target, x, y, places, size, dragged, chosen}
  let typing = null;  // the field that is being typed into: {page, field, before, keys, click}
  let relayed = null; // the click that a label may pass on, or the key that may become a click; gone with the next task

  const step = (verb, target, more = {}) => ({
    page: reading.walk(), verb, ref: target ? reading.refOf(target) : 0, text: '', x: 0, y: 0, dx: 0, dy: 0, ...more,
  });

  const takesText = (node) => (node instanceof HTMLInputElement && !BUTTONS.has(node.type) && !node.readOnly)
    || node instanceof HTMLTextAreaElement || (node instanceof HTMLElement && node.isContentEditable);

  function push(one) {
    steps.push(one);
    relayed = one;
    setTimeout(() => { if (relayed === one) relayed = null; });
  }

  function endTyping() {
    if (typing === null) return;
    const { field, before, keys, begun } = typing;
    typing = null;
    const now = field.isContentEditable ? '' : field.value;
    if (now === before && !keys) {
      if (begun.click) steps.push(begun.click);
    } else {
      steps.push({ ...begun, click: undefined, verb: TYPE, text: now || keys });
    }
  }

  function startTyping(field) {
    if (typing !== null && typing.field === field) return;
    endTyping();
    // A click that only gave the field the focus is part of the typing.
    const last = steps[steps.length - 1];
    const click = last && last.verb === CLICK && last.ref === reading.refOf(field) ? steps.pop() : undefined;
    const begun = { ...step(TYPE, field), click, ...(click && { page: click.page }) };
    typing = { field, before: field.isContentEditable ? '' : field.value, keys: '', begun };
  }

  // ---- the mouse

  function places(node) {
    const found = [];
    for (; node; node = node.parentElement) found.push([node, node.scrollLeft, node.scrollTop]);
    return found;
  }

  const sizeOf = ({ offsetWidth, offsetHeight }) => `${offsetWidth} ${offsetHeight}`;

  function onMouseDown(event) {
    if (event.button !== 0) return;
    endTyping();
    const { target, clientX: x, clientY: y } = event;
    const select = target.closest && target.closest('select');
    down = {
      ...step(CLICK, target, { x, y }), target, places: places(target), size: sizeOf(target), dragged: false,
      chosen: select ? new Set(select.selectedOptions) : null,
    };
  }

  function onMouseUp(event) {
    if (down === null || Math.hypot(event.clientX - down.x, event.clientY - down.y) <= DRAG_PX) return;
    const { page, ref, x, y, target } = down;
    if (target.closest && target.closest('select')) return;
    if (takesText(target) && sizeOf(target) === down.size) return;  // selects what will be copied or typed over
    down.dragged = true;
    const moved = down.places.find(([node, left, top]) => node.scrollLeft !== left || node.scrollTop !== top);
    if (moved) {
      const [node, left, top] = moved;
      pushScroll(node, page, node.scrollLeft - left, node.scrollTop - top);
    } else {
      push({ ...step(DRAG, null), page, ref, x, y, dx: event.clientX - x, dy: event.clientY - y });
    }
  }

  function onClick(event) {
    const { target } = event;
    if (target.closest && target.closest('select')) return;  // its change tells more
    const last = steps[steps.length - 1];
    const passed = relayed !== null && relayed.verb === CLICK && target.labels
      && [...target.labels].some((label) => label.contains(reading.nodeOf(relayed.ref)));
    if (passed || event.detail === 0) {
      // Passed on by a label, or made by a key: what it reaches is what was meant.
      const cause = last && last.verb === PRESS && last.text === ' ' ? last : relayed;  // the space bar acts when let go
      if (cause !== null) Object.assign(cause, { verb: CLICK, ref: reading.refOf(target), text: '', ...middle(target) });
      else push({ ...step(CLICK, target), ...middle(target) });
    } else if (down !== null && !down.dragged) {
      const { page, x, y } = down;
      push({ ...step(CLICK, target, { x, y }), page });
    }
  }

  function middle(target) {
    const box = target.getBoundingClientRect();
    return { x: box.left + box.width / 2, y: box.top + box.height / 2 };
  }

  function onChange(event) {
    const { target } = event;
    if (!(target instanceof HTMLSelectElement)) return;
    const before = down !== null && down.chosen ? down : { ...step(CLICK, target), chosen: new Set() };
    for (const option of target.options) {
      const toggled = target.multiple ? option.selected !== before.chosen.has(option) : option.selected;
      if (toggled) push({ ...step(CLICK, option), page: before.page });
    }
    before.chosen = new Set(target.selectedOptions);
    before.page = reading.walk();
  }

  // Only text fields: what else is scrolled into view could be acted on without.
  function onWheel(event) {
    const field = event.target.closest && event.target.closest('textarea');
    if (!field) return;
    endTyping();
    pushScroll(field, reading.walk(), event.deltaX, event.deltaY);
  }

  function pushScroll(node, page, dx, dy) {
    const last = steps[steps.length - 1], ref = reading.refOf(node);
    if (last && last.verb === SCROLL && last.ref === ref) Object.assign(last, { dx: last.dx + dx, dy: last.dy + dy });
    else steps.push({ ...step(SCROLL, node, { dx, dy }), page, ...middle(node) });
  }

  // ---- the keyboard

  function onKeyDown(event) {
    const { key, target } = event;
    const held = MODIFIERS.filter((name) => event.getModifierState(name) && (name !== 'Shift' || key.length > 1));
    if (MODIFIERS.includes(key) || key === 'Tab' || key === 'CapsLock' || target instanceof HTMLSelectElement) return;
    const command = held.some((name) => name !== 'Shift');
    if (takesText(target)) {
      const newline = key === 'Enter' && target instanceof HTMLTextAreaElement;
      if (command && 'acvx'.includes(key.toLowerCase())) return;  // what they change in the field tells enough
      if (!command && (key.length === 1 || EDITING.has(key) || newline)) {
        startTyping(target);
        if (key.length === 1) typing.keys += key;
        return;
      }
    } else if (command && key.toLowerCase() === 'c') {
      return;
    }
    endTyping();
    push(step(PRESS, target === document.body ? null : target, { text: [...held, key].join('+') }));
  }

  const onBeforeInput = (event) => { if (takesText(event.target)) startTyping(event.target); };

  // ----

  const listeners = {
    mousedown: onMouseDown, mouseup: onMouseUp, click: onClick, change: onChange, wheel: onWheel,
    keydown: onKeyDown, beforeinput: onBeforeInput,
  };
  for (const [name, listener] of Object.entries(listeners)) {
    window.addEventListener(name, (event) => {
      if (event.isTrusted && window.giirl && giirl.isOpen() && !WOB_DONE_GLOBAL) listener(event);
    }, { capture: true, passive: true });
  }

  // A person's time does not stand still.
  let since = null;
  function tick() {
    const now = Date.now();
    if (since !== null && window.giirl && giirl.isOpen() && !WOB_DONE_GLOBAL) clock.pass(now - since, Infinity);
    since = now;
    setTimeout(tick, TICK_MS);
  }

  setTimeout(tick, TICK_MS);

  // The steps since the last call: [columns, verb, ref, text, x, y, dx, dy] each; those of a field not left yet come later.
  function take() {
    const done = WOB_DONE_GLOBAL === true;
    if (done) endTyping();
    const taken = done ? steps : steps.slice(0, -1);  // the last one may still change
    steps = steps.slice(taken.length);
    const told = taken.map(({ page, verb, ref, text, x, y, dx, dy }) => [page, verb, ref, text, x, y, dx, dy]);
    return JSON.stringify([told, done, done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0]);
  }

  function forget() {
    steps = [];
    down = typing = relayed = null;
  }

  Object.defineProperty(window, 'giirlRecorder', { value: { take, forget } });
})();
