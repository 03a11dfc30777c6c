// The keys of the page of giirl feedback: each control names its own in data-key.
(() => {
  'use strict';

  const isTextField = (node) => node instanceof HTMLInputElement && node.type === 'text';

  document.addEventListener('keydown', (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || event.repeat) return;
    if (isTextField(event.target)) {
      if (event.key === 'Escape') event.target.blur();
      return;
    }
    const key = CSS.escape(event.key.toUpperCase());
    const control = document.querySelector(`[data-key="${key}"]`);
    if (control === null) return;
    event.preventDefault();
    control.focus();
    if (!isTextField(control)) control.click();
  });
})();
