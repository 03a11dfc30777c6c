// Runs in the page itself, in every frame: a window that a script opens stays in its tab.
(() => {
  'use strict';
  const { URL } = window;
  window.open = (address) => {
    if (address) window.top.location.assign(new URL(address, document.baseURI));
    return window;
  };
})();
