// Virtual time of a page: it stands still between two steps, so that the same actions always have the same effect.
// With REAL_TIME the page keeps its own clock. Runs before all other scripts, in every frame.
const clock = (() => {
  'use strict';

  const EPOCH_MS = Date.UTC(2025, 0, 1, 12);  // the date at which every episode begins
  const FRAME_MS = 16;
  const DRAIN_FRAME_MS = 1000;  // between animation frames while an old episode is drained
  const SETTLE_MS = 2000;       // the most extra time that the timers of an action get
  const DRAIN_MS = 60000;       // the most time that the timers of an old episode get
  const MAX_CALLS = 5000;       // per run: a page may set timers for ever

  const native = { Date: window.Date };
  for (const name of ['setTimeout', 'requestAnimationFrame']) native[name] = window[name].bind(window);
  if (REAL_TIME) return { native, pass: () => {}, restart: () => {}, mark: () => 0 };

  // id -> {due, call, every, once}; `every` is null unless the timer repeats, `once` is false for animation frames
  const timers = new Map();
  let now = 0, begun = 0, nextId = 1, frameMs = FRAME_MS;

  function add(call, delay, every, once = true) {
    const id = nextId;
    nextId += 1;
    timers.set(id, { due: now + Math.max(Number(delay) || 0, every === null ? 0 : 1), call, every, once });
    return id;
  }

  const callback = (code, args) =>
    (typeof code === 'function' ? () => code.apply(window, args) : () => (0, eval)(String(code)));
  const remove = (id) => { timers.delete(id); };

  window.setTimeout = (code, delay, ...args) => add(callback(code, args), delay, null);
  window.setInterval = (code, delay, ...args) => add(callback(code, args), delay, Math.max(Number(delay) || 0, 1));
  window.requestAnimationFrame = (draw) => add(() => draw(now - begun), frameMs, null, false);
  window.clearTimeout = window.clearInterval = window.cancelAnimationFrame = remove;
  window.performance.now = () => now - begun;

  function PageDate(...parts) {
    if (!new.target) return new native.Date(EPOCH_MS + now - begun).toString();
    const args = parts.length ? parts : [EPOCH_MS + now - begun];
    return Reflect.construct(native.Date, args, new.target === PageDate ? native.Date : new.target);
  }
  Object.setPrototypeOf(PageDate, native.Date);
  PageDate.prototype = native.Date.prototype;
  PageDate.prototype.constructor = PageDate;
  PageDate.now = () => EPOCH_MS + now - begun;
  window.Date = PageDate;

  // Run the timers that are due within `ms`, in order, while `goOn()` is true.
  function run(ms, goOn) {
    const until = now + ms;
    for (let calls = 0; calls < MAX_CALLS && goOn(); calls += 1) {
      let first = null;
      for (const [id, timer] of timers) {
        if (timer.due <= until && (first === null || timer.due < first[1].due)) first = [id, timer];
      }
      if (first === null) return;
      const [id, timer] = first;
      now = Math.max(now, timer.due);
      if (timer.every === null) timers.delete(id);
      else timer.due = now + timer.every;
      try {
        timer.call();
      } catch (error) {
        reportError(error);  // as with any timer, an exception does not stop the others
      }
    }
  }

  // Whether a timeout is due by `until` that was set since the timer id `since`.
  function hasTimeouts(until, since = 0) {
    for (const [id, { due, every, once }] of timers) {
      if (every === null && once && id >= since && due <= until) return true;
    }
    return false;
  }

  function hasFrames() {
    for (const { once, every } of timers.values()) if (!once && every === null) return true;
    return false;
  }

  // Let `ms` pass, and then as much as the timeouts need that were set since `mark`.
  function pass(ms, mark) {
    if (timers.size === 0) {
      now += ms;
      return;
    }
    const until = now + ms, end = now + SETTLE_MS;
    run(ms, () => true);
    now = Math.max(now, until);
    run(end - now, () => hasTimeouts(end, mark));
  }

  // Begin an episode: finish what the last one has started, so that it cannot affect the new one.
  function restart() {
    const end = now + DRAIN_MS;
    frameMs = DRAIN_FRAME_MS;
    run(DRAIN_MS, () => hasTimeouts(end) || hasFrames());
    frameMs = FRAME_MS;
    begun = now;
    for (const timer of timers.values()) if (timer.every !== null) timer.due = now + timer.every;
  }

  return { native, pass, restart, mark: () => nextId };
})();
