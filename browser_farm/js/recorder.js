// Records what a person does as steps, each with the page before it. Only loaded while demonstrations are recorded; it
// runs before all other scripts, so that its listeners read the page before the page reacts.
(() => {
  'use strict';

  const CLICK = 0, TYPE = 1, PRESS = 3, SCROLL = 4, DRAG = 5;  // as in giirl_core.actions.Verb
  const DRAG_PX = 5;      // a click may move the mouse this far
  const TICK_MS = 20;
  const EDITING = new Set(['Backspace', 'Delete', 'ArrowLeft', 'ArrowRight', 'Home', 'End']);
  const MODIFIERS = ['Control', 'Alt', 'Meta', 'Shift'];
  const BUTTONS = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image', 'range', 'color', 'file']);

  const { setTimeout, Date } = window;  // real time: clock.js replaces them later

  let steps = [];
  let down = null;    // where the mouse button was pressed: {page, target, x, y, scrolls, size, dragged, selected}
  let typing = null;  // the field that is being typed into: {field, before, keys, first}
  // The step that may make the browser generate a click: a click on a label, or a key. Reset once its event is handled.
  let cause = null;

  const step = (verb, target, more = {}) => ({
    page: reading.walk(), verb, ref: target ? reading.refOf(target) : 0, text: '', x: 0, y: 0, dx: 0, dy: 0, ...more,
  });

  const takesText = (node) => (node instanceof HTMLInputElement && !BUTTONS.has(node.type) && !node.readOnly)
    || node instanceof HTMLTextAreaElement || (node instanceof HTMLElement && node.isContentEditable);

  function push(one) {
    steps.push(one);
    cause = one;
    setTimeout(() => { if (cause === one) cause = null; });
  }

  function endTyping() {
    if (typing === null) return;
    const { field, before, keys, first } = typing;
    typing = null;
    const value = field.isContentEditable ? '' : field.value;
    if (value === before && !keys) {
      if (first.click) steps.push(first.click);
    } else {
      steps.push({ ...first, click: undefined, verb: TYPE, text: value || keys });
    }
  }

  function startTyping(field) {
    if (typing !== null && typing.field === field) return;
    endTyping();
    // A click that only focused the field is part of the typing.
    const last = steps[steps.length - 1];
    const click = last && last.verb === CLICK && last.ref === reading.refOf(field) ? steps.pop() : undefined;
    const first = { ...step(TYPE, field), click, ...(click && { page: click.page }) };
    typing = { field, before: field.isContentEditable ? '' : field.value, keys: '', first };
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
    const { target, clientX: x, clientY: y } = event;
    const select = selectOf(target);
    down = {
      ...step(CLICK, target, { x, y }), target, scrolls: scrollPositions(target), size: sizeOf(target), dragged: false,
      selected: select ? new Set(select.selectedOptions) : null,
    };
  }

  function onMouseUp(event) {
    if (down === null || Math.hypot(event.clientX - down.x, event.clientY - down.y) <= DRAG_PX) return;
    const { page, ref, x, y, target } = down;
    if (selectOf(target)) return;
    if (takesText(target) && sizeOf(target) === down.size) return;  // selects text that will be copied or replaced
    down.dragged = true;
    const scrolled = down.scrolls.find(([node, left, top]) => node.scrollLeft !== left || node.scrollTop !== top);
    if (scrolled) {
      const [node, left, top] = scrolled;
      pushScroll(node, page, node.scrollLeft - left, node.scrollTop - top);
    } else {
      push({ ...step(DRAG, null), page, ref, x, y, dx: event.clientX - x, dy: event.clientY - y });
    }
  }

  function onClick(event) {
    const { target } = event;
    if (selectOf(target)) return;  // recorded by its change event
    const last = steps[steps.length - 1];
    const fromLabel = cause !== null && cause.verb === CLICK && target.labels
      && [...target.labels].some((label) => label.contains(reading.nodeOf(cause.ref)));
    if (fromLabel || event.detail === 0) {
      // The browser generated this click for a label or a key: record it as a click on its own target.
      const isSpace = last && last.verb === PRESS && last.text === ' ';  // the space bar clicks when it is released
      const origin = isSpace ? last : cause;
      const change = { verb: CLICK, ref: reading.refOf(target), text: '', ...middle(target) };
      if (origin !== null) Object.assign(origin, change);
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
    const before = down !== null && down.selected ? down : { ...step(CLICK, target), selected: new Set() };
    for (const option of target.options) {
      const clicked = target.multiple ? option.selected !== before.selected.has(option) : option.selected;
      if (clicked) push({ ...step(CLICK, option), page: before.page });
    }
    before.selected = new Set(target.selectedOptions);
    before.page = reading.walk();
  }

  // Only in text areas: elsewhere scrolling is not needed, since actions reach elements that are out of view.
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
    if (MODIFIERS.includes(key) || key === 'Tab' || key === 'CapsLock' || target instanceof HTMLSelectElement) return;
    const held = MODIFIERS.filter((name) => event.getModifierState(name) && (name !== 'Shift' || key.length > 1));
    const isCommand = held.some((name) => name !== 'Shift');
    if (takesText(target)) {
      const isNewline = key === 'Enter' && target instanceof HTMLTextAreaElement;
      if (isCommand && 'acvx'.includes(key.toLowerCase())) return;  // recorded by the change to the field's text
      if (!isCommand && (key.length === 1 || EDITING.has(key) || isNewline)) {
        startTyping(target);
        if (key.length === 1) typing.keys += key;
        return;
      }
    } else if (isCommand && key.toLowerCase() === 'c') {
      return;
    }
    endTyping();
    push(step(PRESS, target === document.body ? null : target, { text: [...held, key].join('+') }));
  }

  const onBeforeInput = (event) => { if (takesText(event.target)) startTyping(event.target); };

  // ----

  const isRecording = () => window.giirl && giirl.isOpen() && !WOB_DONE_GLOBAL;

  const listeners = {
    mousedown: onMouseDown, mouseup: onMouseUp, click: onClick, change: onChange, wheel: onWheel,
    keydown: onKeyDown, beforeinput: onBeforeInput,
  };
  for (const [name, listener] of Object.entries(listeners)) {
    window.addEventListener(name, (event) => {
      if (event.isTrusted && isRecording()) listener(event);
    }, { capture: true, passive: true });
  }

  // For a person the page's clock runs in real time.
  let lastTick = null;
  function tick() {
    const now = Date.now();
    if (lastTick !== null && isRecording()) clock.pass(now - lastTick, Infinity);
    lastTick = now;
    setTimeout(tick, TICK_MS);
  }

  setTimeout(tick, TICK_MS);

  // JSON: [steps, done, reward], with the steps that were completed since the last call. Typing is completed when the
  // person leaves the field.
  function take() {
    const done = WOB_DONE_GLOBAL === true;
    if (done) endTyping();
    const taken = done ? steps : steps.slice(0, -1);  // the last one may still change
    steps = steps.slice(taken.length);
    const rows = taken.map(({ page, verb, ref, text, x, y, dx, dy }) => [page, verb, ref, text, x, y, dx, dy]);
    return JSON.stringify([rows, done, done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0]);
  }

  Object.defineProperty(window, 'giirlRecorder', { value: { take } });
})();
