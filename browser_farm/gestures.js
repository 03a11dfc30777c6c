// What a person does to a page, as the events that a browser would send for it. Joined in front of page.js.
const gestures = (() => {
  'use strict';

  const CLICK = 0, TYPE = 1;

  let hovered = null;

  function mouse(target, name, x, y, buttons, bubbles = true) {
    const Kind = name.startsWith('pointer') ? PointerEvent : MouseEvent;
    return target.dispatchEvent(new Kind(name, {
      bubbles, cancelable: bubbles, composed: true, view: window, detail: name === 'click' ? 1 : 0,
      clientX: x, clientY: y, screenX: x, screenY: y, button: 0, buttons, pointerId: 1, isPrimary: true,
    }));
  }

  function hover(element, x, y) {
    if (hovered && hovered !== element && hovered.isConnected) {
      mouse(hovered, 'mouseout', x, y, 0);
      mouse(hovered, 'mouseleave', x, y, 0, false);
    }
    if (hovered !== element) {
      mouse(element, 'pointerover', x, y, 0);
      mouse(element, 'mouseover', x, y, 0);
      mouse(element, 'mouseenter', x, y, 0, false);
    }
    hovered = element;
    mouse(element, 'pointermove', x, y, 0);
    mouse(element, 'mousemove', x, y, 0);
  }

  function focusNear(element) {
    for (let node = element; node && node !== document.body; node = node.parentElement) {
      if (node.focus) node.focus({ preventScroll: true });
      if (document.activeElement === node) return;
    }
    if (document.activeElement && document.activeElement !== document.body) document.activeElement.blur();
  }

  function click(element) {
    if (element.closest(':disabled')) return;
    const box = element.getBoundingClientRect();
    const x = box.left + box.width / 2, y = box.top + box.height / 2;
    hover(element, x, y);
    mouse(element, 'pointerdown', x, y, 1);
    if (mouse(element, 'mousedown', x, y, 1)) focusNear(element);
    mouse(element, 'pointerup', x, y, 0);
    mouse(element, 'mouseup', x, y, 0);
    mouse(element, 'click', x, y, 0);
  }

  function choose(option) {
    const select = option.closest('select');
    if (!select || option.closest(':disabled')) return;
    select.focus({ preventScroll: true });
    if (select.multiple) for (const other of select.options) other.selected = other === option;
    else select.selectedIndex = option.index;
    select.dispatchEvent(new Event('input', { bubbles: true }));
    select.dispatchEvent(new Event('change', { bubbles: true }));
    mouse(option, 'click', 0, 0, 0);
  }

  function key(element, name, character) {
    const upper = character.toUpperCase();
    const keyCode = name === 'keypress' ? character.charCodeAt(0) : upper.charCodeAt(0);
    return element.dispatchEvent(new KeyboardEvent(name, {
      bubbles: true, cancelable: true, composed: true, view: window, key: character, keyCode, which: keyCode,
      charCode: name === 'keypress' ? keyCode : 0, shiftKey: character !== character.toLowerCase(),
    }));
  }

  function write(field, text, inputType, data) {
    // The prototype's setter, because a page may have put its own on the element.
    const kind = field instanceof HTMLTextAreaElement ? HTMLTextAreaElement : HTMLInputElement;
    Object.getOwnPropertyDescriptor(kind.prototype, 'value').set.call(field, text);
    field.dispatchEvent(new InputEvent('input', { bubbles: true, composed: true, inputType, data }));
  }

  function type(element, text) {
    click(element);
    const field = element instanceof HTMLInputElement || element instanceof HTMLTextAreaElement;
    if (!field || element.readOnly || element.disabled || WOB_DONE_GLOBAL || !element.isConnected) return;
    if (document.activeElement !== element) element.focus({ preventScroll: true });
    if (element.value !== '') write(element, '', 'deleteContentBackward', null);
    let typed = '';
    for (const character of text) {
      if (key(element, 'keydown', character) && key(element, 'keypress', character)) {
        if (element.maxLength < 0 || typed.length < element.maxLength) {
          typed += character;
          write(element, typed, 'insertText', character);
        }
      }
      key(element, 'keyup', character);
    }
    element.dispatchEvent(new Event('change', { bubbles: true }));
  }

  function act(verb, node, text) {
    const element = node && node.nodeType === 3 ? node.parentElement : node;  // bare text is clicked through
    if (!element || !element.isConnected) return;
    if (verb === TYPE) type(element, text);
    else if (verb === CLICK && element instanceof HTMLOptionElement) choose(element);
    else if (verb === CLICK) click(element);
  }

  return { act, forget: () => { hovered = null; } };
})();
