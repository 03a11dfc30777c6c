// Runs in the page that opened the tabs of its process. One DevTools call to it asks all of them, at the cost of asking
// one. The answers so far are kept, so a page that never returns does not lose those of the others.
const hub = (() => {
  'use strict';

  const tabs = new Map();  // number -> window
  let call = 0, answers = [], current = null, slowest = [0, null];  // slowest: [ms, tab]

  // `features` as for window.open: "popup" gives each tab a window of its own.
  function open(numbers, features) {
    for (const number of numbers) tabs.set(number, window.open('about:blank', String(number), features));
  }

  function answerOf(tab, request) {
    try {
      const page = tabs.get(tab).giirl;
      return page ? page.answer(request) : '"gone"';
    } catch (error) {
      // DOMException: the tab has navigated to a page that this one may not access.
      return error instanceof DOMException ? '"gone"' : JSON.stringify({ error: String(error) });
    }
  }

  // Ask each tab its request. Returns JSON: [[tab, answer], ...].
  function ask(number, requests) {
    [call, answers, slowest] = [number, [], [0, null]];
    for (const [tab, request] of requests) {
      current = tab;
      const start = performance.now();
      answers.push(`[${tab},${answerOf(tab, request)}]`);
      const ms = performance.now() - start;
      if (ms > slowest[0]) slowest = [ms, tab];
    }
    current = null;
    return `[${answers.join()}]`;
  }

  // After a call was interrupted: JSON of [tab, answers], with the tab that blocked it and the answers so far. That is
  // the current tab; if the page's loop was interrupted and the call went on to its end, it is the slowest one. Returns
  // '' if the call never began.
  function status(number) {
    return number === call ? `[${current === null ? slowest[1] : current},[${answers.join()}]]` : '';
  }

  return { open, ask, status };
})();
