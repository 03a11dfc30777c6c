// What runs inside every task page: opens episodes, acts like a browser would, and reads the page as columns.
(() => {
  'use strict';
  if (window !== window.top || 'giirl' in window) return;

  const FOREVER_MS = 2147483647;  // the longest a timer may wait; the step limit is the farm's
  const IMAGES_MS = 2000;

  let open = false;            // an episode was started in this document

  // A hidden tab draws no frames, so an animation would stand still for ever.
  window.requestAnimationFrame = (frame) => setTimeout(() => frame(performance.now()), 16);
  window.cancelAnimationFrame = (id) => clearTimeout(id);
  window.open = () => null;
  window.console.log = () => {};  // kept by the debugger, one trace of the stack each

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

  // A form sent or a link followed would leave the page in the middle of the next episode.
  window.addEventListener('submit', (event) => event.preventDefault());
  window.addEventListener('click', (event) => {
    const link = event.target.closest ? event.target.closest('a[href]') : null;
    if (link && !/^(#|javascript:)/i.test(link.getAttribute('href'))) event.preventDefault();
  });

  // ---- episodes

  let quiet = false;

  function hush() {
    // Counters and drawings beside the task cost layout time, and the page's own limit is wall-clock time.
    if (quiet) return;
    quiet = true;
    const nothing = () => {};
    for (const name of ['canvasDrawClick', 'canvasDrawElementClick', 'canvasClear', 'updateDisplay',
      'reloadDisplay', 'countdownTimer', 'clearTimer', 'startEpisode']) core[name] = nothing;
    Object.defineProperty(core, 'EPISODE_MAX_TIME', { get: () => FOREVER_MS, set: nothing });
    const display = document.getElementById('reward-display');
    if (display) display.style.display = 'none';
    if (window.jQuery && window.jQuery.fx) window.jQuery.fx.off = true;
  }

  function utterance() {
    const said = core.getUtterance();
    return reading.flat(String(typeof said === 'object' && said !== null ? said.utterance : said));
  }

  function start(seed) {
    hush();
    for (let turn = 0; turn < 2 && ![null, document.body].includes(document.activeElement); turn += 1) {
      document.activeElement.blur();  // once for what is pressed, once for what has the real focus
    }
    gestures.forget();
    keyboard.forget();
    reading.forget();
    core.setDataMode('train');
    Math.seedrandom(seed);
    core.startEpisodeReal();
    open = true;
    const waiting = [...document.images].filter((image) => !image.complete);
    if (waiting.length === 0 && WOB_TASK_READY) return null;
    return Promise.race([settled(waiting), new Promise((go) => setTimeout(go, IMAGES_MS))]);
  }

  async function settled(images) {
    await Promise.all(images.map((image) => image.complete || new Promise((go) => {
      image.addEventListener('load', go);
      image.addEventListener('error', go);
    })));
    while (!WOB_TASK_READY) await new Promise((go) => setTimeout(go, 10));
  }

  let waited = null;  // the answer that step() could not give at once

  function opened(seed, reward, done) {
    const reply = () => JSON.stringify([reward, done, reading.walk(), utterance()]);
    const wait = start(seed);
    if (wait === null) return reply();
    waited = wait.then(reply);
    return 'wait';  // asking Chrome to wait for every answer would cost each step a third more
  }

  // seed is null when no episode of this task follows.
  function step([verb, ref, text, x, y, dx, dy, to], last, seed) {
    gestures.act({
      verb, text, node: reading.nodeOf(ref), at: { x, y }, by: { x: dx, y: dy }, to: reading.nodeOf(to),
    });
    const done = WOB_DONE_GLOBAL === true;
    const reward = done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0;
    if (!done && !last) return JSON.stringify([reward, done, reading.walk(), null]);
    open = false;
    return seed === null ? JSON.stringify([reward, done, null, null]) : opened(seed, reward, done);
  }

  let icons = null;  // held so that they stay in memory

  // An icon of a style sheet has no size until it is loaded, and it loads only where it is first shown.
  function loadIcons() {
    const urls = new Set();
    const gather = (rules, address) => {
      for (const rule of rules) {
        if (rule.cssRules) gather(rule.cssRules, address);
        for (const [, url] of rule.cssText.matchAll(/url\("([^"]+)"\)/g)) urls.add(new URL(url, address).href);
      }
    };
    for (const sheet of document.styleSheets) gather(sheet.cssRules, sheet.href || document.baseURI);
    icons = [...urls].map((url) => Object.assign(new Image(), { src: url }));
    return Promise.race([settled(icons), new Promise((go) => setTimeout(go, IMAGES_MS))]);
  }

  function begin(seed) {
    if (icons !== null) return opened(seed, 0, false);
    const load = document.readyState === 'complete' ? Promise.resolve()
      : new Promise((go) => window.addEventListener('load', () => setTimeout(go)));
    waited = load.then(loadIcons).then(() => opened(seed, 0, false))
      .then((reply) => (reply === 'wait' ? waited : reply));
    return 'wait';
  }

  Object.defineProperty(window, 'giirl', { value: { step, begin, isOpen: () => open, later: () => waited } });
})();
