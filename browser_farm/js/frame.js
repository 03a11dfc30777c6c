// One frame of a page: its time, what is done to it and what it shows. Joined in front of page.js.
const frame = (() => {
  'use strict';

  const STEP_MS = 100;  // how much of the page's time an action takes

  const still = new CSSStyleSheet();  // a style that changes by and by does so in time that is not ours
  still.replaceSync('*, *::before, *::after { transition: none !important; animation: none !important; }');
  document.adoptedStyleSheets = [still];

  window.open = () => null;
  window.console.log = () => {};  // kept by the debugger, one trace of the stack each

  // A form sent or a link followed would leave the page in the middle of the next episode.
  window.addEventListener('submit', (event) => event.preventDefault());
  window.addEventListener('click', (event) => {
    const link = event.target.closest ? event.target.closest('a[href]') : null;
    if (link && !/^(#|javascript:)/i.test(link.getAttribute('href'))) event.preventDefault();
  });

  let turned = false;  // the wheel, by a trusted input
  window.addEventListener('wheel', (event) => { turned ||= event.isTrusted; }, { capture: true, passive: true });

  let aimed = null;  // where time stood when a trusted input was aimed

  // Where the events of an action have to go; nothing where it has no place or only a script can do it.
  function aim([verb, ref, text, x, y, dx, dy, to]) {
    aimed = clock.mark();
    turned = false;
    return gestures.aim({ verb, node: view.nodeOf(ref), at: { x, y }, by: { x: dx, y: dy }, to: view.nodeOf(to) });
  }

  function act([verb, ref, text, x, y, dx, dy, to]) {
    const mark = aimed === null ? clock.mark() : aimed;
    aimed = null;
    gestures.act({
      verb, text, node: view.nodeOf(ref), at: { x, y }, by: { x: dx, y: dy }, to: view.nodeOf(to),
    });
    clock.pass(STEP_MS, mark);
  }

  function calm() {
    if (window.jQuery && window.jQuery.fx) window.jQuery.fx.off = true;
  }

  function forget() {
    for (let turn = 0; turn < 2 && ![null, document.body].includes(document.activeElement); turn += 1) {
      document.activeElement.blur();  // once for what is pressed, once for what has the real focus
    }
    gestures.forget();
    keyboard.forget();
    view.forget();
    clock.restart();
  }

  return { act, aim, turned: () => turned, calm, forget, walk: view.walk, clock };
})();
Object.defineProperty(window, 'giirlFrame', { value: frame });
