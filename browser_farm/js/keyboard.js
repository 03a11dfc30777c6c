// Keyboard actions: key events, and the browser's default action for each. Runs before gestures.js.
const keyboard = (() => {
  'use strict';

  let clipboard = '';

  const PRESSABLE = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image', 'file', 'color', 'range']);
  const isInput = (element) => element instanceof HTMLInputElement || element instanceof HTMLTextAreaElement;
  const takesText = (element) => isInput(element) && !PRESSABLE.has(element.type)
    && !element.readOnly && !element.disabled;

  function dispatchKey(element, name, key, held = {}) {
    const charCode = key === 'Enter' ? 13 : key.charCodeAt(0);
    const keyCode = name === 'keypress' ? charCode : KEY_CODES[key] || codeOf(key);
    return element.dispatchEvent(new KeyboardEvent(name, {
      bubbles: true, cancelable: true, composed: true, view: window, key, keyCode, which: keyCode,
      charCode: name === 'keypress' ? keyCode : 0,
      shiftKey: held.Shift || (key.length === 1 && key !== key.toLowerCase()),
      ctrlKey: held.Control, altKey: held.Alt, metaKey: held.Meta,
    }));
  }

  const codeOf = (key) => (key.length === 1 ? key.toUpperCase().charCodeAt(0) : 0);

  // ---- text

  // The setter of the prototype, because a page may define its own on the element.
  const setters = new Map([HTMLTextAreaElement, HTMLInputElement].map((kind) =>
    [kind, Object.getOwnPropertyDescriptor(kind.prototype, 'value').set]));

  function setValue(field, text, inputType, data) {
    setters.get(field instanceof HTMLTextAreaElement ? HTMLTextAreaElement : HTMLInputElement).call(field, text);
    field.dispatchEvent(new InputEvent('input', { bubbles: true, composed: true, inputType, data }));
  }

  // [start, end] of the selection. Some inputs (number, email) do not expose it; it is taken to be at the end.
  function selectionOf(field) {
    const end = field.value.length;
    return field.selectionStart === null ? [end, end] : [field.selectionStart, field.selectionEnd];
  }

  function setSelection(field, offset, anchor = offset) {
    if (field.selectionStart !== null) field.setSelectionRange(Math.min(offset, anchor), Math.max(offset, anchor));
  }

  function replaceRange(field, start, end, text, inputType) {
    unfinished = null;
    setValue(field, field.value.slice(0, start) + text + field.value.slice(end), inputType, text || null);
    setSelection(field, start + text.length);
  }

  // An unfinished number ("-"), which the field does not report as its value yet: {field, text}.
  let unfinished = null;

  function insert(element, text) {
    if (element.isContentEditable) {
      document.execCommand('insertText', false, text);
    } else if (takesText(element) && element.selectionStart === null) {
      const before = unfinished && unfinished.field === element ? unfinished.text : element.value;
      unfinished = { field: element, text: before + text };
      setValue(element, unfinished.text, 'insertText', text);
    } else if (takesText(element)) {
      const [start, end] = selectionOf(element);
      const room = element.maxLength < 0 ? Infinity : element.maxLength - element.value.length + end - start;
      replaceRange(element, start, end, text.slice(0, Math.max(room, 0)), 'insertText');
    }
  }

  // Date fields and the like accept only a complete value.
  const FORMATTED = new Set(['date', 'time', 'datetime-local', 'month', 'week', 'color', 'range']);

  // The value of a date or time field for what a person types into it ("02/08/2019", "7:16 PM").
  function toFieldValue(field, text) {
    const date = field.type === 'date' && /^\s*(\d{1,2})\/(\d{1,2})\/(\d{4})\s*$/.exec(text);
    if (date) return `${date[3]}-${date[1].padStart(2, '0')}-${date[2].padStart(2, '0')}`;
    const time = field.type === 'time' && /^\s*(\d{1,2}):(\d{2})(?:\s*([AP])M)?\s*$/i.exec(text);
    if (!time) return text;
    const hour = time[3] ? (time[1] % 12) + (/p/i.test(time[3]) ? 12 : 0) : time[1];
    return `${String(hour).padStart(2, '0')}:${time[2]}`;
  }

  // Type into an element, or where the focus is if it is null. `clear` deletes the old text first.
  function type(element, text, clear) {
    let field = element || document.activeElement || document.body;
    if (element && isInput(element) && document.activeElement !== element) element.focus({ preventScroll: true });
    if (element && !isInput(element)) field = document.activeElement || document.body;
    if (element && !field.isConnected) return;
    if (isInput(field) && FORMATTED.has(field.type)) {
      if (field.readOnly || field.disabled) return;
      const isKey = (character) => character in TYPED_KEYS, characters = [...text];
      const value = characters.filter((character) => !isKey(character)).join('');
      if (value || !text) setValue(field, toFieldValue(field, value), 'insertText', value);
      for (const character of characters.filter(isKey)) press(null, TYPED_KEYS[character]);
    } else if (!element || takesText(field) || field.isContentEditable) {
      if (takesText(field) && (clear || element)) {
        unfinished = null;
        if (clear && field.value !== '') setValue(field, '', 'deleteContentBackward', null);
        setSelection(field, field.value.length);
      }
      for (const character of text) {
        typeCharacter(field, character);
        if (!element || character in TYPED_KEYS) field = document.activeElement || document.body;
      }
    } else {
      return;
    }
    if (isInput(field)) field.dispatchEvent(new Event('change', { bubbles: true }));
  }

  function typeCharacter(field, character) {
    if (character in TYPED_KEYS) {
      press(null, TYPED_KEYS[character]);
      return;
    }
    if (dispatchKey(field, 'keydown', character) && dispatchKey(field, 'keypress', character)) insert(field, character);
    dispatchKey(field, 'keyup', character);
  }

  // ---- keys

  // Press a chord ("Control+a"), on an element, or where the focus is if it is null.
  function press(element, chord) {
    const cut = chord.lastIndexOf('+', chord.length - 2);  // the last character may be a plus itself
    const key = chord.slice(cut + 1);
    const held = Object.fromEntries(cut > 0 ? chord.slice(0, cut).split('+').map((name) => [name, true]) : []);
    if (element && document.activeElement !== element) element.focus({ preventScroll: true });
    const target = document.activeElement || document.body;
    for (const name of Object.keys(held)) dispatchKey(target, 'keydown', name, held);
    const isCommand = held.Control || held.Alt || held.Meta;
    const typesText = !isCommand && (key.length === 1 || key === 'Enter');
    if (dispatchKey(target, 'keydown', key, held) && (!typesText || dispatchKey(target, 'keypress', key, held))) {
      if (isCommand) runShortcut(target, key.toLowerCase());
      else if (key.length === 1) pressCharacter(target, key);
      else if (key in DEFAULT_ACTIONS) DEFAULT_ACTIONS[key](target, Boolean(held.Shift));
    }
    const focused = document.activeElement || document.body;
    dispatchKey(focused, 'keyup', key, held);
    for (const name of Object.keys(held)) dispatchKey(focused, 'keyup', name);
  }

  const isPressable = (element) => element instanceof HTMLButtonElement
    || (isInput(element) && PRESSABLE.has(element.type));

  function pressCharacter(target, key) {
    if (key === ' ' && isPressable(target)) gestures.click(target);
    else insert(target, key);
  }

  function pressEnter(target) {
    if (target instanceof HTMLTextAreaElement) insert(target, '\n');
    else if (isPressable(target) || target instanceof HTMLAnchorElement) gestures.click(target);
    else if (isInput(target)) {
      target.dispatchEvent(new Event('change', { bubbles: true }));
      if (target.form) {
        const button = target.form.querySelector('[type=submit], button:not([type])');
        if (button) gestures.click(button);
        else target.form.requestSubmit();
      }
    } else if (target.isContentEditable) document.execCommand('insertParagraph');
  }

  function erase(target, backward) {
    if (target.isContentEditable) document.execCommand(backward ? 'delete' : 'forwardDelete');
    if (!takesText(target)) return;
    let [start, end] = selectionOf(target);
    if (start === end && backward) start = Math.max(0, start - 1);
    else if (start === end) end = Math.min(target.value.length, end + 1);
    const inputType = backward ? 'deleteContentBackward' : 'deleteContentForward';
    if (start < end) replaceRange(target, start, end, '', inputType);
  }

  function moveFocus(target, backward) {
    const focusable = [...document.querySelectorAll('a[href], button, input, select, textarea, [tabindex]')]
      .filter((element) => !element.disabled && element.tabIndex >= 0 && element.getClientRects().length > 0);
    if (focusable.length === 0) return;
    const next = focusable.indexOf(target) + (backward ? -1 : 1);
    focusable[(Math.max(next, backward ? -1 : 0) + focusable.length) % focusable.length].focus();
  }

  // Arrow keys move through a list or a group of radio buttons, or move the caret of a field, or scroll.
  function pressArrow(target, [dx, dy], extend) {
    if (target instanceof HTMLSelectElement) {
      const index = Math.min(Math.max(target.selectedIndex + dx + dy, 0), target.options.length - 1);
      if (index === target.selectedIndex) return;
      target.selectedIndex = index;
      for (const name of ['input', 'change']) target.dispatchEvent(new Event(name, { bubbles: true }));
    } else if (target.type === 'radio') {
      const group = [...document.getElementsByName(target.name)].filter((other) => other.type === 'radio');
      const next = group[(group.indexOf(target) + dx + dy + group.length) % group.length];
      next.focus();
      gestures.click(next);
    } else if (target.type === 'number' && dy) {
      if (dy < 0) target.stepUp();
      else target.stepDown();
      for (const name of ['input', 'change']) target.dispatchEvent(new Event(name, { bubbles: true }));
    } else if (isInput(target) && target.selectionStart !== null && dx) {
      const [start, end] = selectionOf(target);
      if (extend) setSelection(target, dx < 0 ? Math.max(0, start - 1) : start, dx < 0 ? end : end + 1);
      else setSelection(target, start !== end ? (dx < 0 ? start : end) : Math.max(0, start + dx));
    } else {
      scrollNearest(target, dx * LINE_PX, dy * LINE_PX);
    }
  }

  const LINE_PX = 40;

  // Scroll the nearest ancestor that can scroll.
  function scrollNearest(target, left, top) {
    for (let node = target; node; node = node.parentElement) {
      const { scrollLeft, scrollTop } = node;
      node.scrollBy({ left, top, behavior: 'instant' });
      if (node.scrollLeft === scrollLeft && node.scrollTop === scrollTop) continue;
      node.dispatchEvent(new Event('scroll'));
      return;
    }
  }

  function moveToEdge(target, toStart, extend) {
    if (isInput(target) && target.selectionStart !== null) {
      const [start, end] = selectionOf(target), edge = toStart ? 0 : target.value.length;
      setSelection(target, edge, extend ? (toStart ? end : start) : edge);
    } else {
      scrollNearest(target, 0, toStart ? -1e6 : 1e6);
    }
  }

  const pageHeight = (target) => 0.875 * (target.clientHeight || innerHeight);

  const DEFAULT_ACTIONS = {
    Enter: pressEnter,
    Backspace: (target) => erase(target, true),
    Delete: (target) => erase(target, false),
    Tab: moveFocus,
    ArrowLeft: (target, extend) => pressArrow(target, [-1, 0], extend),
    ArrowRight: (target, extend) => pressArrow(target, [1, 0], extend),
    ArrowUp: (target, extend) => pressArrow(target, [0, -1], extend),
    ArrowDown: (target, extend) => pressArrow(target, [0, 1], extend),
    Home: (target, extend) => moveToEdge(target, true, extend),
    End: (target, extend) => moveToEdge(target, false, extend),
    PageUp: (target) => scrollNearest(target, 0, -pageHeight(target)),
    PageDown: (target) => scrollNearest(target, 0, pageHeight(target)),
  };

  // ---- chords

  function selectedText(target) {
    if (!isInput(target) || target.selectionStart === null) return String(getSelection());
    return target.value.slice(target.selectionStart, target.selectionEnd);
  }

  // False if the page prevents it.
  function dispatchClipboard(target, name, clipboardData) {
    return target.dispatchEvent(new ClipboardEvent(name, { bubbles: true, cancelable: true, clipboardData }));
  }

  function runShortcut(target, key) {
    if (key === 'a') {
      if (isInput(target)) target.select();
      else getSelection().selectAllChildren(target.isContentEditable ? target : document.body);
    } else if (key === 'c' || key === 'x') {
      if (!dispatchClipboard(target, key === 'c' ? 'copy' : 'cut', null)) return;
      clipboard = selectedText(target) || clipboard;
      if (key === 'x') erase(target, true);
    } else if (key === 'v') {
      const clipboardData = new DataTransfer();
      clipboardData.setData('text/plain', clipboard);
      if (dispatchClipboard(target, 'paste', clipboardData)) insert(target, clipboard);
    }
  }

  function reset() {
    clipboard = '';
    unfinished = null;
  }

  return { press, type, reset };
})();
