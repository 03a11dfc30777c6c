// What a person's keyboard does to a page: key events, and what a browser does of itself after each.
const keyboard = (() => {
  'use strict';

  let clipboard = '';

  const isField = (element) => element instanceof HTMLInputElement || element instanceof HTMLTextAreaElement;
  const holdsText = (element) => isField(element) && !PRESSABLE.has(element.type) && !element.readOnly && !element.disabled;
  const PRESSABLE = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image', 'file', 'color', 'range']);

  function tell(element, name, key, held = {}) {
    const keyCode = name === 'keypress' ? (key === 'Enter' ? 13 : key.charCodeAt(0)) : KEY_CODES[key] || codeOf(key);
    return element.dispatchEvent(new KeyboardEvent(name, {
      bubbles: true, cancelable: true, composed: true, view: window, key, keyCode, which: keyCode,
      charCode: name === 'keypress' ? keyCode : 0,
      shiftKey: held.Shift || (key.length === 1 && key !== key.toLowerCase()),
      ctrlKey: held.Control, altKey: held.Alt, metaKey: held.Meta,
    }));
  }

  const codeOf = (key) => (key.length === 1 ? key.toUpperCase().charCodeAt(0) : 0);

  // ---- text

  // The prototype's setter, because a page may have put its own on the element.
  const setters = new Map([HTMLTextAreaElement, HTMLInputElement].map((kind) =>
    [kind, Object.getOwnPropertyDescriptor(kind.prototype, 'value').set]));

  function write(field, text, inputType, data) {
    setters.get(field instanceof HTMLTextAreaElement ? HTMLTextAreaElement : HTMLInputElement).call(field, text);
    field.dispatchEvent(new InputEvent('input', { bubbles: true, composed: true, inputType, data }));
  }

  // Some inputs (number, email) do not say where their caret is: there it is at the end.
  function caret(field) {
    const end = field.value.length;
    return field.selectionStart === null ? [end, end] : [field.selectionStart, field.selectionEnd];
  }

  function place(field, offset, anchor = offset) {
    if (field.selectionStart !== null) field.setSelectionRange(Math.min(offset, anchor), Math.max(offset, anchor));
  }

  function replace(field, start, end, text, inputType) {
    partial = null;
    write(field, field.value.slice(0, start) + text + field.value.slice(end), inputType, text || null);
    place(field, start + text.length);
  }

  // A number half typed ("-") is one that the field does not hold yet: {field, text}.
  let partial = null;

  function insert(element, text) {
    if (element.isContentEditable) {
      document.execCommand('insertText', false, text);
    } else if (holdsText(element) && element.selectionStart === null) {
      partial = { field: element, text: (partial && partial.field === element ? partial.text : element.value) + text };
      write(element, partial.text, 'insertText', text);
    } else if (holdsText(element)) {
      const [start, end] = caret(element);
      const room = element.maxLength < 0 ? Infinity : element.maxLength - element.value.length + end - start;
      replace(element, start, end, text.slice(0, Math.max(room, 0)), 'insertText');
    }
  }

  // Dates and the like take a whole value and refuse every beginning of one.
  const WHOLE = new Set(['date', 'time', 'datetime-local', 'month', 'week', 'color', 'range']);

  // What a person types into a date or time field ("02/08/2019", "7:16 PM"), as the field keeps it.
  function kept(field, text) {
    const date = field.type === 'date' && /^\s*(\d{1,2})\/(\d{1,2})\/(\d{4})\s*$/.exec(text);
    if (date) return `${date[3]}-${date[1].padStart(2, '0')}-${date[2].padStart(2, '0')}`;
    const time = field.type === 'time' && /^\s*(\d{1,2}):(\d{2})(?:\s*([AP])M)?\s*$/i.exec(text);
    if (!time) return text;
    const hour = time[3] ? (time[1] % 12) + (/p/i.test(time[3]) ? 12 : 0) : time[1];
    return `${String(hour).padStart(2, '0')}:${time[2]}`;
  }

  function type(element, text, clear) {
    let field = element || document.activeElement || document.body;
    if (element && isField(element) && document.activeElement !== element) element.focus({ preventScroll: true });
    if (element && !isField(element)) field = document.activeElement || document.body;
    if (element && !field.isConnected) return;
    if (isField(field) && WHOLE.has(field.type)) {
      if (field.readOnly || field.disabled) return;
      write(field, kept(field, text), 'insertText', text);
    } else if (!element || holdsText(field) || field.isContentEditable) {
      if (holdsText(field) && (clear || element)) {
        partial = null;
        if (clear && field.value !== '') write(field, '', 'deleteContentBackward', null);
        place(field, field.value.length);
      }
      for (const character of text) {
        stroke(field, character);
        if (!element) field = document.activeElement || document.body;
      }
    } else {
      return;
    }
    if (isField(field)) field.dispatchEvent(new Event('change', { bubbles: true }));
  }

  function stroke(field, character) {
    const key = character === '\n' ? 'Enter' : character;
    if (tell(field, 'keydown', key) && tell(field, 'keypress', key)) {
      if (key === 'Enter') enter(field);
      else insert(field, character);
    }
    tell(field, 'keyup', key);
  }

  // ---- keys

  function press(element, chord) {
    const cut = chord.lastIndexOf('+', chord.length - 2);
    const key = chord.slice(cut + 1);
    const held = Object.fromEntries(cut > 0 ? chord.slice(0, cut).split('+').map((name) => [name, true]) : []);
    if (element && document.activeElement !== element) element.focus({ preventScroll: true });
    const target = document.activeElement || document.body;
    for (const name of Object.keys(held)) tell(target, 'keydown', name, held);
    const command = held.Control || held.Alt || held.Meta;
    const typed = !command && (key.length === 1 || key === 'Enter');
    if (tell(target, 'keydown', key, held) && (!typed || tell(target, 'keypress', key, held))) {
      if (command) shortcut(target, key.toLowerCase());
      else if (key.length === 1) character(target, key);
      else if (key in KEYS) KEYS[key](target, Boolean(held.Shift));
    }
    const now = document.activeElement || document.body;
    tell(now, 'keyup', key, held);
    for (const name of Object.keys(held)) tell(now, 'keyup', name);
  }

  const isPressed = (element) => element instanceof HTMLButtonElement || (isField(element) && PRESSABLE.has(element.type));

  function character(target, key) {
    if (key === ' ' && isPressed(target)) gestures.click(target);
    else insert(target, key);
  }

  function enter(target) {
    if (target instanceof HTMLTextAreaElement) insert(target, '\n');
    else if (isPressed(target) || target instanceof HTMLAnchorElement) gestures.click(target);
    else if (isField(target)) {
      target.dispatchEvent(new Event('change', { bubbles: true }));
      if (target.form) {
        const button = target.form.querySelector('[type=submit], button:not([type])');
        if (button) gestures.click(button);
        else target.form.requestSubmit();
      }
    } else if (target.isContentEditable) document.execCommand('insertParagraph');
  }

  function erase(target, back) {
    if (target.isContentEditable) document.execCommand(back ? 'delete' : 'forwardDelete');
    if (!holdsText(target)) return;
    let [start, end] = caret(target);
    if (start === end && back) start = Math.max(0, start - 1);
    else if (start === end) end = Math.min(target.value.length, end + 1);
    if (start < end) replace(target, start, end, '', back ? 'deleteContentBackward' : 'deleteContentForward');
  }

  function tab(target, back) {
    const all = [...document.querySelectorAll('a[href], button, input, select, textarea, [tabindex]')]
      .filter((element) => !element.disabled && element.tabIndex >= 0 && element.getClientRects().length > 0);
    if (all.length === 0) return;
    const next = all.indexOf(target) + (back ? -1 : 1);
    all[(Math.max(next, back ? -1 : 0) + all.length) % all.length].focus();
  }

  // Arrows move through a list or a group of radio buttons, the caret of a field, or the page.
  function go(target, [dx, dy], extend) {
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
    } else if (isField(target) && target.selectionStart !== null && dx) {
      const [start, end] = caret(target);
      if (extend) place(target, dx < 0 ? Math.max(0, start - 1) : start, dx < 0 ? end : end + 1);
      else place(target, start !== end ? (dx < 0 ? start : end) : Math.max(0, start + dx));
    } else {
      scrollBy(target, dx * LINE_PX, dy * LINE_PX);
    }
  }

  const LINE_PX = 40;

  function scrollBy(target, left, top) {
    for (let node = target; node; node = node.parentElement) {
      const { scrollLeft, scrollTop } = node;
      node.scrollBy({ left, top, behavior: 'instant' });
      if (node.scrollLeft === scrollLeft && node.scrollTop === scrollTop) continue;
      node.dispatchEvent(new Event('scroll'));
      return;
    }
  }

  function edge(target, back, extend) {
    if (isField(target) && target.selectionStart !== null) {
      const [start, end] = caret(target), goal = back ? 0 : target.value.length;
      place(target, goal, extend ? (back ? end : start) : goal);
    } else {
      scrollBy(target, 0, back ? -1e6 : 1e6);
    }
  }

  const page = (target) => 0.875 * (target.clientHeight || innerHeight);

  const KEYS = {
    Enter: enter,
    Backspace: (target) => erase(target, true),
    Delete: (target) => erase(target, false),
    Tab: tab,
    ArrowLeft: (target, extend) => go(target, [-1, 0], extend),
    ArrowRight: (target, extend) => go(target, [1, 0], extend),
    ArrowUp: (target, extend) => go(target, [0, -1], extend),
    ArrowDown: (target, extend) => go(target, [0, 1], extend),
    Home: (target, extend) => edge(target, true, extend),
    End: (target, extend) => edge(target, false, extend),
    PageUp: (target) => scrollBy(target, 0, -page(target)),
    PageDown: (target) => scrollBy(target, 0, page(target)),
  };

  // ---- chords

  function selected(target) {
    if (!isField(target) || target.selectionStart === null) return String(getSelection());
    return target.value.slice(target.selectionStart, target.selectionEnd);
  }

  function shortcut(target, key) {
    if (key === 'a') {
      if (isField(target)) target.select();
      else getSelection().selectAllChildren(target.isContentEditable ? target : document.body);
    } else if (key === 'c' || key === 'x') {
      const told = target.dispatchEvent(new ClipboardEvent(key === 'c' ? 'copy' : 'cut', { bubbles: true, cancelable: true }));
      if (!told) return;
      clipboard = selected(target) || clipboard;
      if (key === 'x') erase(target, true);
    } else if (key === 'v') {
      const clipboardData = new DataTransfer();
      clipboardData.setData('text/plain', clipboard);
      const told = target.dispatchEvent(new ClipboardEvent('paste', { bubbles: true, cancelable: true, clipboardData }));
      if (told) insert(target, clipboard);
    }
  }

  return { press, type, forget: () => { clipboard = ''; partial = null; } };
})();
