// Records a person on a MiniWoB page. It runs before all other scripts, so that it sees each event before the page.
(() => {
  'use strict';

  const TICK_MS = 20;
  const { setTimeout, Date } = window;  // real time: clock.js replaces them later

  const isRecording = () => window.giirl && giirl.isOpen() && !WOB_DONE_GLOBAL;
  const recorded = person({
    read: () => reading.walk(), rowOf: (node) => node, offsetOf: () => ({ x: 0, y: 0 }), isRecording, changed: () => {},
  });
  recorded.listen(window);

  // For a person the page's clock runs in real time.
  let lastTick = null;
  function tick() {
    const now = Date.now();
    if (lastTick !== null && isRecording()) clock.pass(now - lastTick, Infinity);
    lastTick = now;
    setTimeout(tick, TICK_MS);
  }

  setTimeout(tick, TICK_MS);

  // JSON: [steps, done, reward], with the steps that were completed since the last call. Typing is completed when the
  // person leaves the field.
  function take() {
    const done = WOB_DONE_GLOBAL === true;
    const rows = recorded.take(done)
      .map(({ page, verb, ref, text, x, y, dx, dy }) => [page, verb, ref, text, x, y, dx, dy]);
    return JSON.stringify([rows, done, done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0]);
  }

  Object.defineProperty(window, 'giirlRecorder', { value: { take } });
})();
