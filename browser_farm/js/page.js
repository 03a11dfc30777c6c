// Runs in every task page: opens episodes, performs actions and returns the page as columns.
(() => {
  'use strict';
  if (window !== window.top) return;

  const NO_LIMIT_MS = 2147483647;  // for the page's own time limit: the longest timeout; the farm limits the steps
  const LOADING_MS = 20000;        // files that are missing fail at once, so this is for a slow machine
  const WHEEL_MS = 3000, FRAME_MS = 200;  // the longest wait for a wheel event, and for a frame
  const DRAWN_FRAMES = 2;  // in real time, before the page is read
  const OPENING_MS = 100;  // virtual time before the first observation: pages draw with their next animation frame
  const WAIT = '"wait"', GONE = '"gone"';  // as in pages.py

  let open = false;            // an episode was started in this document

  const { setTimeout, requestAnimationFrame } = clock.native;  // real time, for what the page has to load
  const wait = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
  const nextFrame = () => Promise.race([new Promise((resolve) => requestAnimationFrame(resolve)), wait(FRAME_MS)]);

  async function drawn(frames) {
    for (let count = 0; count < frames; count += 1) await nextFrame();
  }

  // The frame that shows the task. For a flight task that is an iframe; null when it has navigated to another site.
  function taskFrame() {
    const wrap = document.getElementById('wrap');
    if (!(wrap instanceof HTMLIFrameElement)) return frame;
    try {
      return wrap.contentWindow.giirlFrame || null;
    } catch {
      return null;
    }
  }

  let extrasRemoved = REAL_TIME;

  function removeExtras() {
    // Counters and drawings around the task cost layout time, and the page's own time limit is in real time.
    if (extrasRemoved) return;
    extrasRemoved = true;
    const nothing = () => {};
    document.body.removeEventListener('click', core.canvasDrawClick);
    if (core.cover_div) core.cover_div.remove();
    core.cover_div = { style: {} };
    for (const name of ['canvasDrawClick', 'canvasDrawElementClick', 'canvasClear', 'updateDisplay',
      'reloadDisplay', 'countdownTimer', 'clearTimer', 'startEpisode']) core[name] = nothing;
    Object.defineProperty(core, 'EPISODE_MAX_TIME', { get: () => NO_LIMIT_MS, set: nothing });
    const display = document.getElementById('reward-display');
    if (display) display.style.display = 'none';
    frame.disableAnimations();
  }

  function utterance() {
    const value = core.getUtterance();
    return reading.collapse(String(typeof value === 'object' && value !== null ? value.utterance : value));
  }

  // A drawing of core.visualizeAttention belongs to the episode in which it was made.
  function removeAttention() {
    const canvas = document.getElementById('attention-canvas');
    if (canvas) canvas.remove();
    delete core.attentionCtx;
  }

  // Start an episode. Returns null if its page is complete, else a promise that resolves when it is. `seed` is text,
  // since a number is exact to 2^53 only; with its \0 it gives the same page as the number would.
  function start([seed, mode]) {
    removeExtras();
    removeAttention();
    frame.reset();
    core.setDataMode(mode);
    Math.seedrandom(`${seed}\0`);
    const mark = clock.mark();
    core.startEpisodeReal();
    clock.pass(OPENING_MS, mark);
    open = true;
    const loading = [...document.images].filter((image) => !image.complete);
    if (REAL_TIME) return Promise.race([loaded(loading), wait(LOADING_MS)]).then(() => drawn(DRAWN_FRAMES));
    if (loading.length === 0 && WOB_TASK_READY) return null;
    return Promise.race([loaded(loading), wait(LOADING_MS)]);
  }

  async function loaded(images) {
    await Promise.all(images.map((image) => image.complete || new Promise((resolve) => {
      image.addEventListener('load', resolve);
      image.addEventListener('error', resolve);
    })));
    while (!WOB_TASK_READY) {
      await wait(10);
      const task = taskFrame();
      if (task) {
        task.disableAnimations();
        task.clock.pass(10, 0);
      }
    }
  }

  // ---- answers, all of them JSON: [reward, done, columns, utterance, reason, scaled reward], see pages.decode

  let pending = null;  // promise of the answer that could not be given at once

  function answerAfter(complete, answerNow) {
    pending = complete.then(answerNow).then((reply) => (reply === WAIT ? pending : reply));
    return WAIT;  // if every call awaited a promise, each step would take a third longer
  }

  function openEpisode(next, reward, done, ...reason) {
    const answerNow = () => JSON.stringify([reward, done, (taskFrame() || frame).walk(), utterance(), ...reason]);
    const complete = start(next);
    return complete === null ? answerNow() : answerAfter(complete, answerNow);
  }

  // `next` is [seed, mode] of the next episode, null if none follows in this document.
  function step(action, last, next) {
    if (!open) return GONE;
    const task = taskFrame();
    if (!task) core.endEpisode(-1, false, 'navigated away');  // as the page does when it notices
    else if (!REAL_TIME || !WOB_DONE_GLOBAL) task.act(action);  // in real time the episode may be over already
    if (!REAL_TIME) return stepped(last, next);
    return answerAfter(wait(WAIT_MS).then(() => drawn(DRAWN_FRAMES)), () => stepped(last, next));
  }

  // The answer after an action.
  function stepped(last, next) {
    const done = WOB_DONE_GLOBAL === true;
    const reward = done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0;
    const reason = done && WOB_REWARD_REASON ? [String(WOB_REWARD_REASON)] : [];
    if (done && REAL_TIME) reason.push(...(reason.length ? [] : ['']), Number(WOB_REWARD_GLOBAL) || 0);
    if (!done && !last) return JSON.stringify([reward, done, (taskFrame() || frame).walk(), null]);
    open = false;
    if (next === null) return JSON.stringify([reward, done, null, null, ...reason]);
    return openEpisode(next, reward, done, ...reason);
  }

  // The coordinates for trusted input, which the farm sends before a step that only waits.
  function aim(action) {
    const task = taskFrame();
    return open ? JSON.stringify(task ? task.aim(action) : null) : GONE;
  }

  // Resolves after Chrome has dispatched a trusted wheel event, which it delays, and drawn the frames that scroll.
  async function scrollDrawn() {
    const task = taskFrame();
    for (let ms = 0; ms < WHEEL_MS && task && !task.wheelTurned(); ms += 10) await wait(10);
    await drawn(3);
    return '';
  }

  let icons = null;  // kept, so that the images stay in memory

  // An icon of a style sheet has no size before it is loaded, and is loaded only when it is first drawn.
  function loadIcons() {
    const urls = new Set();
    const addUrls = (rules, base) => {
      for (const rule of rules) {
        if (rule.cssRules) addUrls(rule.cssRules, base);
        for (const [, url] of rule.cssText.matchAll(/url\("([^"]+)"\)/g)) urls.add(new URL(url, base).href);
      }
    };
    for (const sheet of document.styleSheets) addUrls(sheet.cssRules, sheet.href || document.baseURI);
    icons = [...urls].map((url) => {
      const image = Object.assign(new Image(), { src: url }), element = document.createElement('giirl-icon');
      element.style.cssText = `position: fixed; left: -9999px; content: url("${url}")`;
      document.documentElement.append(element);  // outside the body, which is read
      return { image, element };
    });
    return Promise.race([iconsDrawn(), wait(LOADING_MS)]);
  }

  // An image that another tab has loaded is complete at once, but gets its size a moment later.
  async function iconsDrawn() {
    await loaded(icons.map(({ image }) => image));
    for (const { image, element } of icons) {
      while (image.naturalWidth > 0 && element.getBoundingClientRect().width === 0) {
        await wait(5);
      }
    }
  }

  // Open the first episode of a new document, or another one without a step.
  function begin(next) {
    if (icons !== null) return openEpisode(next, 0, false);
    const documentLoaded = document.readyState === 'complete' ? Promise.resolve()
      : new Promise((resolve) => window.addEventListener('load', () => setTimeout(resolve)));
    return answerAfter(documentLoaded.then(loadIcons), () => openEpisode(next, 0, false));
  }

  // The requests of pages.py differ in their length: start_call has 1 entry, aim_call 2, step_call 3.
  const answer = (request) => [begin, aim, step][request.length - 1](...request);

  Object.defineProperty(window, 'giirl', {
    value: { answer, isOpen: () => open, scrollDrawn, pendingAnswer: () => pending },
  });
})();
