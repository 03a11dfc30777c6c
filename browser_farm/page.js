// What runs inside every task page: opens episodes, acts like a browser would, and reads the page as columns.
(() => {
  'use strict';
  if (window !== window.top || 'giirl' in window) return;

  const FOREVER_MS = 2147483647;  // the longest a timer may wait; the step limit is the farm's
  const IMAGES_MS = 2000;
  const FURNITURE = new Set(['query', 'reward-display', 'sync-task-cover', 'click-canvas', 'attention-canvas']);
  const MUTE = new Set(['script', 'style', 'br', 'head', 'link', 'meta', 'title', 'template', 'noscript']);

  let open = false;            // an episode was started in this document
  let tampered = new WeakSet();
  let refs = new WeakMap();    // node -> ref
  let nodes = [null];          // ref -> node

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


  window.addEventListener('click', (event) => { tampered.add(event.target); }, true);
  // A form sent or a link followed would leave the page in the middle of the next episode.
  window.addEventListener('submit', (event) => event.preventDefault());
  window.addEventListener('click', (event) => {
    const link = event.target.closest ? event.target.closest('a[href]') : null;
    if (link && !/^(#|javascript:)/i.test(link.getAttribute('href'))) event.preventDefault();
  });

  // ---- reading

  function refOf(node) {
    let ref = refs.get(node);
    if (ref === undefined) {
      ref = nodes.push(node) - 1;
      refs.set(node, ref);
    }
    return ref;
  }

  const flat = (text) => text.replace(/\s+/g, ' ').trim().toWellFormed();

  function valueOf(element) {
    if (element instanceof HTMLInputElement) {
      if (element.type === 'checkbox' || element.type === 'radio') return element.checked ? 'checked' : '';
      return element.value.toWellFormed();
    }
    if (element instanceof HTMLTextAreaElement || element instanceof HTMLSelectElement) {
      return element.value.toWellFormed();
    }
    return element instanceof HTMLOptionElement && element.selected ? 'checked' : '';
  }

  function walk() {
    const tag = [], text = [], value = [], classes = [], numbers = [], boxes = [];
    const active = document.activeElement;

    function row(node, parent, name, words, box) {
      const bare = name === 't';
      tag.push(name);
      text.push(words);
      value.push(bare ? '' : valueOf(node));
      classes.push(bare ? '' : node.getAttribute('class') || '');
      numbers.push(refOf(node), parent, (node === active ? 1 : 0) | (tampered.has(node) ? 2 : 0));
      boxes.push(box.left, box.top, box.width, box.height);
      return tag.length - 1;
    }

    // One row for each line the text takes, as a reader sees it.
    function textRows(node, parent) {
      const range = document.createRange();
      range.selectNodeContents(node);
      const rects = range.getClientRects();
      if (rects.length === 1) {
        if (rects[0].width > 0 && rects[0].height > 0) row(node, parent, 't', flat(node.data), rects[0]);
        return;
      }
      let line = null;
      const end = () => { if (line) row(node, parent, 't', flat(line.words.join(' ')), line.box()); };
      for (const word of node.data.matchAll(/\S+/g)) {
        range.setStart(node, word.index);
        range.setEnd(node, word.index + word[0].length);
        const rect = range.getClientRects()[0];
        if (!rect || rect.width === 0 || rect.height === 0) continue;
        if (!line || Math.abs(line.top - rect.top) > 1) {
          end();
          line = new Line(rect);
        }
        line.words.push(word[0]);
        line.right = Math.max(line.right, rect.right);
      }
      end();
    }

    function options(select, parent) {
      // A closed list shows nothing of its options, yet a person can choose each of them.
      const box = select.getBoundingClientRect();
      for (const option of select.options) {
        const rect = option.getBoundingClientRect();
        row(option, parent, 'option', flat(option.text), rect.width > 0 && rect.height > 0 ? rect : box);
      }
    }

    function visit(element, parent) {
      const name = element.localName.toLowerCase();
      if (MUTE.has(name) || FURNITURE.has(element.id)) return;
      const box = element.getBoundingClientRect();
      if (box.width === 0 || box.height === 0) return;
      const input = element instanceof HTMLInputElement;
      const leaf = element.firstElementChild === null;
      let here = parent;
      if (element.id !== 'wrap') {
        here = row(element, parent, input ? 'input_' + element.type : name,
          leaf && !input && name !== 'textarea' ? flat(element.textContent) : '', box);
      }
      if (element instanceof HTMLSelectElement) options(element, here);
      else if (!leaf || element.id === 'wrap') children(element, here);
    }

    function children(element, parent) {
      for (let node = element.firstChild; node !== null; node = node.nextSibling) {
        if (node.nodeType === 1) visit(node, parent);
        else if (node.nodeType === 3 && /\S/.test(node.data)) textRows(node, parent);
      }
    }

    children(document.body, -1);
    return [tag, text, value, classes, numbers, boxes];
  }

  class Line {
    constructor(rect) {
      this.words = [];
      this.left = rect.left;
      this.top = rect.top;
      this.right = rect.right;
      this.height = rect.height;
    }

    box() {
      return { left: this.left, top: this.top, width: this.right - this.left, height: this.height };
    }
  }

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
    return flat(String(typeof said === 'object' && said !== null ? said.utterance : said));
  }

  function start(seed) {
    hush();
    for (let turn = 0; turn < 2 && ![null, document.body].includes(document.activeElement); turn += 1) {
      document.activeElement.blur();  // once for what is pressed, once for what has the real focus
    }
    gestures.forget();
    tampered = new WeakSet();
    refs = new WeakMap();
    nodes = [null];
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
    const reply = () => JSON.stringify([reward, done, walk(), utterance()]);
    const wait = start(seed);
    if (wait === null) return reply();
    waited = wait.then(reply);
    return 'wait';  // asking Chrome to wait for every answer would cost each step a third more
  }

  // seed is null when no episode of this task follows.
  function step(verb, ref, text, last, seed) {
    gestures.act(verb, nodes[ref], text);
    const done = WOB_DONE_GLOBAL === true;
    const reward = done ? Number(WOB_RAW_REWARD_GLOBAL) || 0 : 0;
    if (!done && !last) return JSON.stringify([reward, done, walk(), null]);
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
