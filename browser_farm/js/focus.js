// Focus in a hidden tab: it moves and fires the same events as in a visible one.
(() => {
  'use strict';

  // Moving the real focus costs Chrome a third of a step. For elements that can only be pressed it is enough to report
  // them as document.activeElement; elements that hold text get the real focus.
  const PRESSABLE = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image']);
  const nativeActiveElement = Object.getOwnPropertyDescriptor(Document.prototype, 'activeElement').get;
  const nativeFocus = HTMLElement.prototype.focus;
  let pressed = null;  // the element that is reported as focused without having the real focus
  Object.defineProperty(document, 'activeElement', {
    get: () => (pressed && pressed.isConnected ? pressed : nativeActiveElement.call(document)),
  });

  function isPressable(element) {
    return (element instanceof HTMLButtonElement || element instanceof HTMLInputElement)
      && PRESSABLE.has(element.type) && !element.disabled && element.getClientRects().length > 0;
  }

  // blur() leaves the focus in an inner part of a date field; only focusing another element removes it.
  function release(element, blur) {
    blur.call(element);
    if (nativeActiveElement.call(document) !== element) return;
    document.body.tabIndex = -1;
    nativeFocus.call(document.body);
    document.body.removeAttribute('tabindex');
  }

  // A hidden tab changes its active element without firing events. Fire those of a visible tab.
  for (const prototype of [HTMLElement.prototype, SVGElement.prototype]) {
    const { focus, blur } = prototype;
    prototype.focus = function focusWithEvents(...options) {
      const before = document.activeElement;
      if (!document.hasFocus() && isPressable(this)) {
        const focused = nativeActiveElement.call(document);
        if (focused && focused !== document.body) release(focused, blur);
        pressed = this;
      } else {
        focus.apply(this, options);
        if (nativeActiveElement.call(document) === this) pressed = null;
      }
      dispatchFocusEvents(before, document.activeElement);
    };
    prototype.blur = function blurWithEvents() {
      const before = document.activeElement;
      if (pressed === this) pressed = null;
      else release(this, blur);
      dispatchFocusEvents(before, document.activeElement);
    };
  }

  function dispatchFocusEvents(before, after) {
    if (before === after || document.hasFocus()) return;
    const dispatch = (element, events, relatedTarget) => {
      if (!element || element === document.body) return;
      for (const [name, bubbles] of events) {
        element.dispatchEvent(new FocusEvent(name, { bubbles, composed: true, view: window, relatedTarget }));
      }
    };
    dispatch(before, [['blur', false], ['focusout', true]], after);
    dispatch(after, [['focus', false], ['focusin', true]], before);
  }
})();
