// The focus of a tab that Chrome does not show: it moves, and says so, as in one that is shown.
(() => {
  'use strict';

  // Giving the focus to an element and taking it away again costs Chrome a third of a step. For what is only pressed
  // it is enough that the page takes it for focused; whatever holds text gets the real focus.
  const PRESSED = new Set(['button', 'submit', 'reset', 'checkbox', 'radio', 'image']);
  const nativeActive = Object.getOwnPropertyDescriptor(Document.prototype, 'activeElement').get;
  const nativeFocus = HTMLElement.prototype.focus;
  let pressed = null;
  Object.defineProperty(document, 'activeElement', {
    get: () => (pressed && pressed.isConnected ? pressed : nativeActive.call(document)),
  });

  function canBePressed(element) {
    return (element instanceof HTMLButtonElement || element instanceof HTMLInputElement)
      && PRESSED.has(element.type) && !element.disabled && element.getClientRects().length > 0;
  }

  // A date field keeps the focus in one of its inner parts whatever blur() says, until another element takes it.
  function release(element, blur) {
    blur.call(element);
    if (nativeActive.call(document) !== element) return;
    document.body.tabIndex = -1;
    nativeFocus.call(document.body);
    document.body.removeAttribute('tabindex');
  }

  // A hidden tab has no focus: its active element changes without a word. Say what a shown one would say.
  for (const kind of [HTMLElement.prototype, SVGElement.prototype]) {
    const { focus, blur } = kind;
    kind.focus = function focusAndTell(...options) {
      const before = document.activeElement;
      if (!document.hasFocus() && canBePressed(this)) {
        const real = nativeActive.call(document);
        if (real && real !== document.body) release(real, blur);
        pressed = this;
      } else {
        focus.apply(this, options);
        if (nativeActive.call(document) === this) pressed = null;
      }
      focusMoved(before, document.activeElement);
    };
    kind.blur = function blurAndTell() {
      const before = document.activeElement;
      if (pressed === this) pressed = null;
      else release(this, blur);
      focusMoved(before, document.activeElement);
    };
  }

  function focusMoved(before, after) {
    if (before === after || document.hasFocus()) return;
    const tell = (element, names, relatedTarget) => {
      if (!element || element === document.body) return;
      for (const [name, bubbles] of names) {
        element.dispatchEvent(new FocusEvent(name, { bubbles, composed: true, view: window, relatedTarget }));
      }
    };
    tell(before, [['blur', false], ['focusout', true]], after);
    tell(after, [['focus', false], ['focusin', true]], before);
  }
})();
