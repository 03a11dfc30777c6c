// One frame of a page: its clock, the actions on it and its content. Runs before page.js.
const frame = (() => {
  'use strict';

  const STEP_MS = 100;  // virtual time that an action takes

  if (!REAL_TIME) {
    const noTransitions = new CSSStyleSheet();  // CSS transitions run in real time, not in the clock's
    noTransitions.replaceSync('*, *::before, *::after { transition: none !important; animation: none !important; }');
    document.adoptedStyleSheets = [noTransitions];
  }

  window.open = () => null;
  window.console.log = () => {};  // the debugger would store each message with a stack trace

  // Submitting a form or following a link would unload the page in the middle of the next episode.
  window.addEventListener('submit', (event) => event.preventDefault());
  window.addEventListener('click', (event) => {
    const link = event.target.closest ? event.target.closest('a[href]') : null;
    if (link && !/^(#|javascript:)/i.test(link.getAttribute('href'))) event.preventDefault();
  });

  let wheelTurned = false;  // by trusted input, since the last aim()
  window.addEventListener('wheel', (event) => { wheelTurned ||= event.isTrusted; }, { capture: true, passive: true });

  let aimMark = null;  // the clock's mark when trusted input was aimed

  const decode = ([verb, ref, text, x, y, dx, dy, to]) => ({
    verb, text, node: view.nodeOf(ref), at: { x, y }, by: { x: dx, y: dy }, to: view.nodeOf(to),
  });

  // Coordinates for the input events of an action; null if it has none, or if only a script can perform it.
  function aim(action) {
    aimMark = clock.mark();
    wheelTurned = false;
    return gestures.aim(decode(action));
  }

  function act(action) {
    const mark = aimMark === null ? clock.mark() : aimMark;
    aimMark = null;
    gestures.act(decode(action));
    clock.pass(STEP_MS + WAIT_MS, mark);
  }

  function disableAnimations() {
    if (!REAL_TIME && window.jQuery && window.jQuery.fx) window.jQuery.fx.off = true;
  }

  function reset() {
    for (let round = 0; round < 2 && ![null, document.body].includes(document.activeElement); round += 1) {
      document.activeElement.blur();  // once for the reported focus, once for the real one: see focus.js
    }
    gestures.reset();
    keyboard.reset();
    view.reset();
    clock.restart();
  }

  return { act, aim, wheelTurned: () => wheelTurned, disableAnimations, reset, walk: view.walk, clock };
})();
Object.defineProperty(window, 'giirlFrame', { value: frame });
