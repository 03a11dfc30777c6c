// Records a person on a page of one's own. The page may be left at any moment, so each change of a step is sent at once,
// through a binding that only our world has. MOST is the number of elements that are read.
(() => {
  'use strict';
  if (window !== window.top) return;  // frames of the same origin are listened to from here

  const passwords = new WeakSet();  // fields that hide, or have hidden, what is typed
  let sent = [];  // JSON of each step, and its page

  reading.number(1);

  // The page's columns, the rows of password fields, and all refs.
  function read() {
    const [columns, roots] = reading.read(MOST), numbers = columns[5];  // as in sites/page.py
    for (const root of roots) for (const field of root.querySelectorAll('input[type=password]')) passwords.add(field);
    const refs = numbers.filter((_, index) => index % 3 === 0);
    const hidden = refs.flatMap((ref, row) => (passwords.has(reading.nodeOf(ref)) ? [row] : []));
    return { columns, hidden, refs: new Set(refs) };
  }

  // The nearest element around a node that has a row.
  function rowOf(node, { refs }) {
    const outer = (each) => each.parentNode || each.host || (each.defaultView && each.defaultView.frameElement);
    for (let each = node; each; each = outer(each)) {
      if (refs.has(reading.refOf(each))) return each;
    }
    return null;
  }

  // Sends [number, step, page] for each step that has changed; a step that is none any more is null.
  function send() {
    const steps = recorded.soFar();
    for (let number = 0; number < Math.max(steps.length, sent.length); number += 1) {
      const one = steps[number] || null, before = sent[number] || {};
      const step = one && [one.verb, one.ref, one.text, one.x, one.y, one.dx, one.dy, passwords.has(one.target)];
      const text = JSON.stringify(step), isNewPage = one !== null && one.page !== before.page;
      if (text === before.text && !isNewPage) continue;
      giirlStep(JSON.stringify([number, step, isNewPage ? [one.page.columns, one.page.hidden] : null]));
      sent[number] = { text, page: one && one.page };
    }
    sent = sent.slice(0, steps.length);
  }

  const recorded = person({ read, rowOf, offsetOf: reading.offsetOf, isRecording: () => true, changed: send });
  recorded.listen(window);
  window.addEventListener('pagehide', send);

  // Listen also to the frames that are there by now.
  const known = new WeakSet([document]);
  function listen() {
    for (const root of reading.read(1)[1]) {
      if (root.nodeType !== 9 || known.has(root)) continue;
      known.add(root);
      recorded.listen(root.defaultView);
    }
  }

  window.giirlRecorder = { listen };
})();
