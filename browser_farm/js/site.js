// Actions on a page of one's own, and whether it is quiet. Runs in every frame, in a world of its own.
(() => {
  'use strict';

  // As in giirl_core.actions.Verb.
  const CLICK = 0, TYPE = 1, APPEND = 2, SCROLL = 4, DOUBLE_CLICK = 7, WAIT = 11;
  const FORMATTED = new Set(['date', 'time', 'datetime-local', 'month', 'week', 'color', 'range']);
  const LOADING_MS = 20;  // until a document that is being parsed is looked at again

  // ---- a window that a page opens stays in its tab

  const staysHere = (name) => ['', '_self', '_top', '_parent'].includes(name) || Boolean(window.frames[name]);

  window.addEventListener('click', (event) => {
    const link = event.composedPath().find((node) => node.nodeType === 1 && node.matches('a[target], area[target]'));
    if (link && !staysHere(link.target)) link.target = '_top';
  }, true);
  window.addEventListener('submit', (event) => {
    const form = event.target;
    if (!staysHere(form.target)) form.target = '_top';
    const button = event.submitter;
    if (button && !staysHere(button.formTarget)) button.formTarget = '_top';
  }, true);
  if (window !== window.top) return;

  // ---- changes of the page

  let changed = performance.now(), last = null;  // when the page has changed, and where
  let ignored = '';
  const watched = new WeakSet();

  const isIgnored = (node) => ignored !== '' && node.nodeType === 1 && node.closest(ignored) !== null;
  const note = (node) => {
    changed = performance.now();
    last = node;
  };
  const observer = new MutationObserver((records) => {
    for (const { target } of records) {
      if (!isIgnored(target.nodeType === 3 ? target.parentElement || target : target)) note(target);
    }
  });

  function watch(root) {
    if (watched.has(root)) return;
    watched.add(root);
    observer.observe(root, { subtree: true, childList: true, attributes: true, characterData: true });
    note(root);
  }

  watch(document);
  window.addEventListener('scroll', () => note(document), { capture: true, passive: true });

  const isLoading = (root) => root.nodeType === 9 && root.readyState !== 'complete';

  // JSON of the page's columns if it has not changed for `quiet` ms, else of the ms to wait. See sites/session.py.
  function observe(quiet, first, most, ignore) {
    if (ignore !== '') document.documentElement.matches(ignore);  // an error in the selector is reported
    ignored = ignore;
    if (isLoading(document)) return JSON.stringify(LOADING_MS);
    const left = changed + quiet - performance.now();
    if (left > 0) return JSON.stringify(Math.ceil(left));
    reading.number(first);
    const [columns, roots] = reading.read(most);
    const before = changed;
    for (const root of roots) watch(root);
    if (roots.some(isLoading)) return JSON.stringify(LOADING_MS);
    return JSON.stringify(changed === before ? columns : quiet);
  }

  // What keeps the page from being quiet: the last element that changed.
  function restless() {
    const element = last && (last.nodeType === 1 ? last : last.parentElement);
    if (isLoading(document) || !element) return document.readyState;
    const name = element.localName + (element.id ? `#${element.id}` : '');
    return name + [...element.classList].map((one) => `.${one}`).join('');
  }

  // Whether an element that matches is visible, in any document of the page.
  function has(selector) {
    const [, roots] = reading.read(1);
    return roots.some((root) => [...root.querySelectorAll(selector)].some((element) => reading.isDrawn(element)));
  }

  // ---- actions

  const isFile = (element) => reading.named(element, 'input') && element.type === 'file';

  // Where an action is, as [x, y, end x, end y] in CSS px. Text says why it is refused; null if it is done already, or
  // if its element is gone.
  function aim(verb, ref, text, x, y, dx, dy, to) {
    if (verb === WAIT) return null;
    const node = ref ? reading.nodeOf(ref) : null, end = to ? reading.nodeOf(to) : null;
    if ((ref && !(node && node.isConnected)) || (to && !(end && end.isConnected))) return null;
    const element = node && (node.nodeType === 3 ? node.parentElement : node);
    if (element) reading.mark(node);
    if (element && verb !== SCROLL) {
      const label = element.closest('label');
      if (isFile(element) || (label && label.control && isFile(label.control))) return 'file inputs are refused';
    }
    if (element && reading.named(element, 'option')) {
      if (verb === CLICK || verb === DOUBLE_CLICK) select(element);
      return null;
    }
    if (element && FORMATTED.has(element.type) && (verb === TYPE || verb === APPEND)) {
      setValue(element, fieldValue(element, text));
      return null;
    }
    const from = node ? point(node, x, y) : { x, y };
    if (node && verb !== SCROLL && !isHit(node, from)) {
      element.scrollIntoView({ block: 'center', inline: 'center', behavior: 'instant' });  // from below a fixed header
      Object.assign(from, point(node, x, y));
    }
    const goal = end ? point(end, dx, dy) : { x: from.x + dx, y: from.y + dy };
    return [from.x, from.y, goal.x, goal.y];
  }

  // The middle of the first part of a node that is drawn, scrolled into view, plus an offset.
  function point(node, x, y) {
    const element = node.nodeType === 3 ? node.parentElement : node;
    element.scrollIntoView({ block: 'nearest', inline: 'nearest', behavior: 'instant' });
    const rects = [...reading.rectsOf(node)].filter((rect) => rect.width > 0 && rect.height > 0);
    const box = rects[0] || reading.boxOf(node), offset = reading.offsetOf(node);
    return { x: offset.x + box.left + box.width / 2 + x, y: offset.y + box.top + box.height / 2 + y };
  }

  function isHit(node, at) {
    const element = node.nodeType === 3 ? node.parentElement : node, offset = reading.offsetOf(node);
    const hit = element.getRootNode().elementFromPoint(at.x - offset.x, at.y - offset.y);
    return hit !== null && (hit.contains(element) || element.contains(hit));
  }

  function select(option) {
    const list = option.closest('select');
    if (!list || list.disabled || option.disabled) return;
    list.focus({ preventScroll: true });
    reading.mark(list);
    if (list.multiple) option.selected = !option.selected;
    else list.selectedIndex = option.index;
    for (const name of ['input', 'change']) list.dispatchEvent(new Event(name, { bubbles: true }));
  }

  function setValue(field, value) {
    if (field.readOnly || field.disabled) return;
    field.focus({ preventScroll: true });
    field.value = value;
    for (const name of ['input', 'change']) field.dispatchEvent(new Event(name, { bubbles: true }));
  }

  // The value of a date or time field for what a person types into it ("02/08/2019", "7:16 PM").
  function fieldValue(field, text) {
    const date = field.type === 'date' && /^\s*(\d{1,2})\/(\d{1,2})\/(\d{4})\s*$/.exec(text);
    if (date) return `${date[3]}-${date[1].padStart(2, '0')}-${date[2].padStart(2, '0')}`;
    const time = field.type === 'time' && /^\s*(\d{1,2}):(\d{2})(?:\s*([AP])M)?\s*$/i.exec(text);
    if (!time) return text.trim();
    const hour = time[3] ? (time[1] % 12) + (/p/i.test(time[3]) ? 12 : 0) : time[1];
    return `${String(hour).padStart(2, '0')}:${time[2]}`;
  }

  window.giirl = { observe, restless, has, aim };
})();
