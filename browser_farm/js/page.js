// What runs inside every task page: opens episodes, acts like a browser would, and reads the page as columns.
(() => {
  'use strict';
  if (window !== window.top) return;

  const FOREVER_MS = 2147483647;  // the longest a timer may wait; the step limit is the farm's
  const IMAGES_MS = 20000;  // what does not load fails at once: this is for a machine that is busy
  const WHEEL_MS = 3000, FRAME_MS = 200;  // how long to wait for each
  const OPENING_MS = 100;  // of the page's time before it is first seen: what it draws, it draws with the next frame
  const WAIT = '"wait"', GONE = '"gone"';

  let open = false;            // an episode was started in this document

  const { setTimeout } = clock.native;  // for what the page itself has to load

  // The flight tasks show the site of an airline in a frame; null when that has left for somewhere else.
  function shown() {
    const wrap = document.getElementById('wrap');
    if (!(wrap instanceof HTMLIFrameElement)) return frame;
    try {
      return wrap.contentWindow.giirlFrame || null;
    } catch {
      return null;
    }
  }

  let quiet = false;

  function hush() {
    // Counters and drawings beside the task cost layout time, and the page's own limit is wall-clock time.
    if (quiet) return;
    quiet = true;
    const nothing = () => {};
    document.body.removeEventListener('click', core.canvasDrawClick);
    if (core.cover_div) core.cover_div.remove();
    core.cover_div = { style: {} };
    for (const name of ['canvasDrawClick', 'canvasDrawElementClick', 'canvasClear', 'updateDisplay',
      'reloadDisplay', 'countdownTimer', 'clearTimer', 'startEpisode']) core[name] = nothing;
    Object.defineProperty(core, 'EPISODE_MAX_TIME', { get: () => FOREVER_MS, set: nothing });
    const display = document.getElementById('reward-display');
    if (display) display.style.display = 'none';
    frame.calm();
  }

  function utterance() {
    const said = core.getUtterance();
    return reading.flat(String(typeof said === 'object' && said !== null ? said.utterance : said));
  }

  function start([seed, mode]) {
    hush();
    frame.forget();
    core.setDataMode(mode);
    Math.seedrandom(seed);
    const mark = clock.mark();
    core.startEpisodeReal();
    clock.pass(OPENING_MS, mark);
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
    while (!WOB_TASK_READY) {
      await new Promise((go) => setTimeout(go, 10));
      const loading = shown();
      if (loading) {
        loading.calm();
        loading.clock.pass(10, 0);
      }
    }
  }

  let waited = null;  // the answer that step() could not give at once

  function opened(next, reward, done, ...reason) {
    const reply = () => JSON.stringify([reward, done, (shown() || frame).walk(), utterance(), ...reason]);
    const wait = start(next);
    if (wait === null) return reply();
    waited = wait.then(reply);
    return WAIT;  // asking Chrome to wait for every answer would cost each step a third more
  }

  // next is null when no episode of this task follows.
  function step(action, last, next) {
    if (!open) return GONE;
    const site = shown();
    if (site) site.act(action);
    else core.endEpisode(-1, false, 'navigated away');  // what the page itself says of it, where it can
    const done = WOB_DONE_GLOBAL === true;
    const reward = done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0;
    const reason = done && WOB_REWARD_REASON ? [String(WOB_REWARD_REASON)] : [];
    if (!done && !last) return JSON.stringify([reward, done, (shown() || frame).walk(), null]);
    open = false;
    return next === null ? JSON.stringify([reward, done, null, null, ...reason]) : opened(next, reward, done, ...reason);
  }

  // For trusted input: where to send it, before a step that only waits.
  function aim(action) {
    const site = shown();
    return open ? JSON.stringify(site ? site.aim(action) : null) : GONE;
  }

  // Chrome hands on a turn of the wheel when it is ready to, and moves the page with one of the frames that follow.
  async function drawn() {
    const site = shown(), wait = (ms) => new Promise((go) => setTimeout(go, ms));
    for (let ms = 0; ms < WHEEL_MS && site && !site.turned(); ms += 10) await wait(10);
    for (let frame = 0; frame < 3; frame += 1) {
      await Promise.race([new Promise((go) => clock.native.requestAnimationFrame(go)), wait(FRAME_MS)]);
    }
    return '';
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
    icons = [...urls].map((url) => {
      const image = Object.assign(new Image(), { src: url }), shown = document.createElement('giirl-icon');
      shown.style.cssText = `position: fixed; left: -9999px; content: url("${url}")`;
      document.documentElement.append(shown);  // beside the body, where nobody looks
      return { image, shown };
    });
    return Promise.race([shownIcons(), new Promise((go) => setTimeout(go, IMAGES_MS))]);
  }

  // Loaded is not yet shown: what another tab has loaded is there at once, and has its size a moment later.
  async function shownIcons() {
    await settled(icons.map(({ image }) => image));
    for (const { image, shown } of icons) {
      while (image.naturalWidth > 0 && shown.getBoundingClientRect().width === 0) {
        await new Promise((go) => setTimeout(go, 5));
      }
    }
  }

  function begin(next) {
    if (icons !== null) return opened(next, 0, false);
    const load = document.readyState === 'complete' ? Promise.resolve()
      : new Promise((go) => window.addEventListener('load', () => setTimeout(go)));
    waited = load.then(loadIcons).then(() => opened(next, 0, false))
      .then((reply) => (reply === WAIT ? waited : reply));
    return WAIT;
  }

  // All answers are JSON.
  const answer = (words) => [begin, aim, step][words.length - 1](...words);

  Object.defineProperty(window, 'giirl', { value: { answer, isOpen: () => open, drawn, later: () => waited } });
})();
