// Runs in a page that opened the tabs of its process: one call from outside asks all of them, which costs as much as
// asking one. What each said is kept, so that one that never answers does not take the others' words with it.
const hub = (() => {
  'use strict';

  const tabs = new Map();  // number -> window
  let call = 0, said = [], asked = null, slowest = [0, null];

  function open(numbers) {
    for (const number of numbers) tabs.set(number, window.open('about:blank', String(number)));
  }

  function answer(tab, words) {
    try {
      const page = tabs.get(tab).giirl;
      return page ? page.answer(words) : '"gone"';
    } catch (error) {
      // A page from elsewhere does not even say that it is one.
      return error instanceof DOMException ? '"gone"' : JSON.stringify({ error: String(error) });
    }
  }

  function ask(number, questions) {
    [call, said, slowest] = [number, [], [0, null]];
    for (const [tab, words] of questions) {
      asked = tab;
      const since = performance.now();
      said.push(`[${tab},${answer(tab, words)}]`);
      const took = performance.now() - since;
      if (took > slowest[0]) slowest = [took, tab];
    }
    asked = null;
    return `[${said.join()}]`;
  }

  // What came of a call that was broken off: whose answer is missing or took longest, since a loop may end and its page
  // go on; and the answers so far. Nothing if the call never began.
  const told = (number) => (number === call ? `[${asked === null ? slowest[1] : asked},[${said.join()}]]` : '');

  return { open, ask, told };
})();
