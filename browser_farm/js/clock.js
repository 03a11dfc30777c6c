// The time that a page lives in: it stands still between two steps, so that the same actions meet the same page.
// Joined in front of all others, in every frame.
const clock = (() => {
  'use strict';

  const EPOCH_MS = Date.UTC(2025, 0, 1, 12);  // what a page takes for now when its episode begins
  const FRAME_MS = 16;
  const LAST_FRAME_MS = 1000; // between frames that nobody will see
  const SETTLE_MS = 2000;     // how long to wait at most for what an action set going
  const DRAIN_MS = 60000;     // how much is left over from an episode at most
  const MAX_CALLS = 5000;     // in one advance: a page may set timers for ever

  const native = { Date: window.Date };
  for (const name of ['setTimeout', 'requestAnimationFrame']) native[name] = window[name].bind(window);
  const timers = new Map();   // id -> {due, call, every}
  let now = 0, begun = 0, nextId = 1, frameMs = FRAME_MS;

  function add(call, delay, every, once = true) {
    const id = nextId;
    nextId += 1;
    timers.set(id, { due: now + Math.max(Number(delay) || 0, every === null ? 0 : 1), call, every, once });
    return id;
  }

  const bound = (code, rest) => (typeof code === 'function' ? () => code.apply(window, rest) : () => (0, eval)(String(code)));
  const remove = (id) => { timers.delete(id); };

  window.setTimeout = (code, delay, ...rest) => add(bound(code, rest), delay, null);
  window.setInterval = (code, delay, ...rest) => add(bound(code, rest), delay, Math.max(Number(delay) || 0, 1));
  window.requestAnimationFrame = (frame) => add(() => frame(now - begun), frameMs, null, false);
  window.clearTimeout = window.clearInterval = window.cancelAnimationFrame = remove;
  window.performance.now = () => now - begun;

  function PageDate(...parts) {
    if (!new.target) return new native.Date(EPOCH_MS + now - begun).toString();
    const given = parts.length ? parts : [EPOCH_MS + now - begun];
    return Reflect.construct(native.Date, given, new.target === PageDate ? native.Date : new.target);
  }
  Object.setPrototypeOf(PageDate, native.Date);
  PageDate.prototype = native.Date.prototype;
  PageDate.prototype.constructor = PageDate;
  PageDate.now = () => EPOCH_MS + now - begun;
  window.Date = PageDate;

  // Run what is due until `ms` from now, in its order; `more` says whether to go on before that.
  function run(ms, more) {
    const until = now + ms;
    for (let calls = 0; calls < MAX_CALLS && more(); calls += 1) {
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
        reportError(error);  // as for any timer: it ends nothing else
      }
    }
  }

  function someWait(within, since = 0) {
    for (const [id, { due, every, once }] of timers) if (every === null && once && id >= since && due <= within) return true;
    return false;
  }

  // Let `ms` go by, and then as much as the timers still need that were set since `mark`.
  function pass(ms, mark) {
    if (timers.size === 0) {
      now += ms;
      return;
    }
    const until = now + ms, end = now + SETTLE_MS;
    run(ms, () => true);
    now = Math.max(now, until);
    run(end - now, () => someWait(end, mark));
  }

  // Nothing of the last episode may reach into the next.
  function restart() {
    const end = now + DRAIN_MS;
    frameMs = LAST_FRAME_MS;
    run(DRAIN_MS, () => someWait(end) || someFrames());
    frameMs = FRAME_MS;
    begun = now;
    for (const timer of timers.values()) if (timer.every !== null) timer.due = now + timer.every;
  }

  function someFrames() {
    for (const { once, every } of timers.values()) if (!once && every === null) return true;
    return false;
  }

  return { native, pass, restart, mark: () => nextId };
})();
