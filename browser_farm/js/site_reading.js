// Reads what is visible or can be reached on a page of one's own, as columns: frames of the same origin and open shadow
// roots too. Runs in a world of its own, so the page's scripts neither see nor change it.
const reading = (() => {
  'use strict';

  const FOCUSED = 1, TAMPERED = 2;  // as in pages.py
  const TEXT_LENGTH = 200;          // characters of a text or a value that are read
  const INVISIBLE = new Set(['script', 'style', 'br', 'head', 'link', 'meta', 'title', 'template', 'noscript', 'wbr',
    'colgroup', 'datalist', 'param', 'source', 'track']);
  const PRESSABLE = 'a[href], button, summary, label, [role=button], [role=link], [role=tab], [role=menuitem], '
    + '[role=option], [role=switch], [role=checkbox], [role=radio], [onclick]';
  const FIELDS = 'input, select, textarea, iframe, [contenteditable=""], [contenteditable=true]';
  const WRAPPERS = new Set(['div', 'span', 'section', 'main', 'article', 'aside', 'header', 'footer', 'nav', 'tbody',
    'thead', 'tr', 'th', 'td', 'ul', 'ol', 'li', 'dl', 'dt', 'dd', 'center', 'fieldset', 'form', 'slot', 'p', 'iframe',
    'strong', 'b', 'em', 'i', 'u', 'small', 'font', 'body']);
  const TYPED_AS = { tel: 'text', url: 'text', 'datetime-local': 'text', month: 'text', week: 'text' };

  let refs = new WeakMap(), nodes = new Map(), nextRef = 0;  // node -> ref, ref -> node
  const tampered = new WeakSet();  // acted on in this document

  function refOf(node) {
    let ref = refs.get(node);
    if (ref === undefined) {
      ref = nextRef;
      nextRef += 1;
      refs.set(node, ref);
      nodes.set(ref, node);
    }
    return ref;
  }

  // Called with the first ref that no earlier document of the episode has used.
  const number = (first) => { nextRef = Math.max(nextRef, first); };

  const collapse = (text) => text.replace(/\s+/g, ' ').trim().slice(0, TEXT_LENGTH).toWellFormed();
  const named = (node, ...names) => names.includes(node.localName);  // instanceof fails across frames

  // ---- where things are, in the coordinates of the outermost page

  function offsetOf(node) {
    let x = 0, y = 0;
    for (let view = node.ownerDocument.defaultView; view && view !== window; view = view.parent) {
      const frame = view.frameElement, box = frame.getBoundingClientRect();
      x += box.left + frame.clientLeft;
      y += box.top + frame.clientTop;
    }
    return { x, y };
  }

  function rectsOf(node) {
    if (node.nodeType === 1) return node.getClientRects();
    const range = node.ownerDocument.createRange();
    range.selectNodeContents(node);
    return range.getClientRects();
  }

  function boxOf(node) {
    if (node.nodeType === 1) return node.getBoundingClientRect();
    const range = node.ownerDocument.createRange();
    range.selectNodeContents(node);
    return range.getBoundingClientRect();
  }

  // ---- what an element says

  const isEditable = (element) => element.isContentEditable && !(element.parentElement || {}).isContentEditable;

  function tagOf(element) {
    if (named(element, 'input')) return `input_${TYPED_AS[element.type] || element.type}`;
    return isEditable(element) ? 'textarea' : element.localName.toLowerCase();
  }

  // The name that a person reads beside a field.
  function nameOf(element) {
    const owner = element.getRootNode();
    const texts = (element.getAttribute('aria-labelledby') || '').split(/\s+/).filter(Boolean)
      .map((id) => owner.getElementById && owner.getElementById(id)).filter(Boolean).map((one) => one.textContent);
    const label = [...element.labels || []].map((one) => textOf(one).trim() || pictureOf(one)).join(' ');
    for (const name of [texts.join(' '), element.getAttribute('aria-label'), label, element.placeholder, element.alt,
      element.title]) {
      if (name && /\S/.test(name)) return collapse(name);
    }
    return '';
  }

  // What a picture in an element says instead of words.
  const pictureOf = (element) => [...element.querySelectorAll('img[alt]')].map(({ alt }) => alt).join(' ');

  // The text of an element without the fields in it.
  function textOf(element) {
    if (!element.querySelector('select, textarea')) return element.textContent;
    return [...element.childNodes].filter((node) => node.nodeType === 3).map((node) => node.data).join(' ');
  }

  const BUTTONS = new Set(['submit', 'button', 'reset', 'image']);

  function valueOf(element) {
    if (named(element, 'input')) {
      if (element.type === 'checkbox' || element.type === 'radio') return element.checked ? 'checked' : '';
      return BUTTONS.has(element.type) ? '' : collapse(element.value);
    }
    if (named(element, 'textarea')) return collapse(element.value);
    if (named(element, 'select')) return collapse([...element.selectedOptions].map((one) => one.text).join(', '));
    if (named(element, 'option')) return element.selected ? 'checked' : '';
    if (isEditable(element)) return collapse(element.innerText);
    return element.getAttribute('aria-checked') === 'true' ? 'checked' : '';
  }

  function wordsOf(element, isLeaf) {
    if (named(element, 'input') && BUTTONS.has(element.type)) return collapse(element.value || element.alt || 'Submit');
    if (named(element, 'input', 'select', 'textarea') || isEditable(element)) return nameOf(element);
    if (!isLeaf) return '';
    const seen = collapse(element.innerText === undefined ? element.textContent : element.innerText);
    const written = collapse(element.textContent);  // a style may show it in capitals
    return (seen.toLowerCase() === written.toLowerCase() ? written : seen) || nameOf(element)
      || collapse(pictureOf(element));
  }

  // ---- walking

  function childrenOf(element) {
    if (element.shadowRoot) return element.shadowRoot.childNodes;
    if (named(element, 'slot') && element.assignedNodes().length) return element.assignedNodes();
    if (named(element, 'iframe')) {
      const inner = innerDocument(element);
      return inner && inner.body ? [inner.body] : [];
    }
    return element.childNodes;
  }

  function innerDocument(iframe) {
    try {
      return iframe.contentDocument;
    } catch {
      return null;  // of another origin
    }
  }

  const isDrawn = (element) => element.checkVisibility({ visibilityProperty: true, opacityProperty: true });

  // The part of a document in which its content can be seen or scrolled to: all but what is left of it or above it.
  const reachOf = ({ scrollX, scrollY }) => ({ left: -scrollX, top: -scrollY, right: Infinity, bottom: Infinity });
  const isWithin = (box, reach) => box.right > reach.left && box.left < reach.right
    && box.bottom > reach.top && box.top < reach.bottom;

  // The reach of what is in an element: one that does not scroll cuts off what is outside of it.
  function reachIn(element, box, reach, { overflowX, overflowY }) {
    if (named(element, 'iframe')) return innerDocument(element) ? reachOf(element.contentWindow) : reach;
    const cuts = (overflow) => overflow === 'hidden' || overflow === 'clip';
    if (overflowX === 'visible' && overflowY === 'visible') return reach;
    const everywhere = { left: -Infinity, top: -Infinity, right: Infinity, bottom: Infinity };
    const { left, right } = cuts(overflowX) ? box : everywhere, { top, bottom } = cuts(overflowY) ? box : everywhere;
    return { left, top, right, bottom };
  }

  const isPressable = (element) => element.matches(PRESSABLE) && !element.querySelector(`${PRESSABLE}, ${FIELDS}`);
  // A leaf without words that somebody could still mean to click.
  const isMeant = (element) => named(element, 'img', 'svg', 'canvas', 'video', 'input', 'select', 'textarea', 'option',
    'button', 'a') || element.matches('[title], [aria-label], [tabindex], [onclick], [role]');

  // [rows, watched]: all rows of the page, and the documents and shadow roots they are from.
  function walk() {
    const rows = [], watched = [document];

    function addRow(node, parent, tag, text, value, box, isOption = false) {
      const { x, y } = offsetOf(node);
      const isText = tag === 't';
      rows.push({ node, parent, tag, text, value, isOption, children: 0,
        classes: isText ? '' : node.getAttribute('class') || '', attributes: isText ? '' : collapse(attributesOf(node)),
        box: [box.left + x, box.top + y, box.width, box.height],
      });
      if (parent >= 0) rows[parent].children += 1;
      return rows.length - 1;
    }

    function visit(node, parent, reach) {
      if (node.nodeType === 3) {
        const box = /\S/.test(node.data) ? boxOf(node) : null;
        if (box && box.width > 0 && box.height > 0 && isWithin(box, reach)) {
          addRow(node, parent, 't', collapse(node.data), '', box);
        }
      } else if (node.nodeType === 1 && !INVISIBLE.has(node.localName) && !node.inert) {
        visitElement(node, parent, reach);
      }
    }

    function visitElement(element, parent, around) {
      if (element.shadowRoot) watched.push(element.shadowRoot);
      if (named(element, 'iframe') && innerDocument(element)) watched.push(innerDocument(element));
      const style = getComputedStyle(element), box = element.getBoundingClientRect();
      if (style.display === 'none' || (style.display !== 'contents' && !isDrawn(element))) return;
      const isPlaced = style.position === 'absolute' || style.position === 'fixed';  // may leave what surrounds it
      const reach = isPlaced ? reachOf(element.ownerDocument.defaultView) : around;
      if (box.width === 0 || box.height === 0 || !isWithin(box, reach)) {
        if (style.display === 'contents' || style.overflow === 'visible') visitAll(element, parent, reach);
        return;
      }
      const isLeaf = isPressable(element) || isEditable(element)
        || named(element, 'svg', 'input', 'textarea', 'select');
      const row = addRow(element, parent, tagOf(element), '', valueOf(element), box);
      if (named(element, 'select')) addOptions(element, row);
      else if (!isLeaf) visitAll(element, row, reachIn(element, box, reach, style));
      const only = rows.length === row + 2 && rows[row + 1].tag === 't' && !named(element, 'iframe');
      if (only) rows.length = row + 1;  // nothing but a text: the element itself is the leaf
      if (only) rows[row].children = 0;
      rows[row].text = wordsOf(element, isLeaf || only);
      const isNothing = rows.length === row + 1 && !rows[row].text && !isMeant(element);
      if (isNothing) {
        rows.length = row;
        if (parent >= 0) rows[parent].children -= 1;
      }
    }

    function addOptions(select, parent) {
      const box = select.getBoundingClientRect();
      for (const option of select.options) {
        if (option.disabled) continue;
        const own = option.getBoundingClientRect();
        addRow(option, parent, 'option', collapse(option.text), valueOf(option), own.width > 0 ? own : box, true);
      }
    }

    function visitAll(element, parent, reach) {
      for (const child of childrenOf(element)) visit(child, parent, reach);
    }

    const modals = [...document.querySelectorAll(':modal')];  // nothing outside can be reached
    if (modals.length) visit(modals[modals.length - 1], -1, reachOf(window));
    else if (document.body) visitAll(document.body, -1, reachOf(window));
    return [rows, watched];
  }

  // A wrapper with one row in it says nothing but its class and attributes: its row is left out, and they go to a row
  // without. Returns the indices of the rows that stay.
  function unwrapped(rows) {
    const isWrapper = ({ children, tag }) => children === 1 && WRAPPERS.has(tag);
    for (const row of rows) {
      const outer = rows[row.parent];
      if (outer && isWrapper(outer)) for (const name of ['classes', 'attributes']) row[name] ||= outer[name];
    }
    return rows.map((_, index) => index).filter((index) => !isWrapper(rows[index]));
  }

  // The distance of a row from what is in view, px; the options of lists come after the elements.
  function distance({ box: [left, top, width, height], isOption }) {
    const across = Math.max(-left - width, left - innerWidth, 0), along = Math.max(-top - height, top - innerHeight, 0);
    return across + along + (isOption ? 1 : 0);
  }

  // At most `most` rows with their ancestors: those nearest to what is in view, then in the order of the document.
  function cut(rows, kept, most) {
    if (kept.length <= most) return kept;
    const stays = new Set(kept), chosen = new Set(), far = new Map(kept.map((index) => [index, distance(rows[index])]));
    for (const index of [...kept].sort((one, other) => far.get(one) - far.get(other) || one - other)) {
      const chain = [];
      for (let each = index; each >= 0 && !chosen.has(each); each = rows[each].parent) {
        if (stays.has(each)) chain.push(each);
      }
      if (chosen.size + chain.length > most) break;
      for (const each of chain) chosen.add(each);
    }
    return [...chosen].sort((one, other) => one - other);
  }

  function activeNode() {
    let active = document.activeElement;
    for (;;) {
      const inner = active && (active.shadowRoot || (named(active, 'iframe') && innerDocument(active)));
      if (!inner || !inner.activeElement) return active;
      active = inner.activeElement;
    }
  }

  // The columns of sites/page.py, and what to watch for changes.
  function read(most) {
    const [rows, watched] = walk();
    const all = unwrapped(rows), kept = cut(rows, all, most);
    const place = new Map(kept.map((index, row) => [index, row]));
    const parentOf = (index) => {
      let each = rows[index].parent;
      while (each >= 0 && !place.has(each)) each = rows[each].parent;
      return each >= 0 ? place.get(each) : -1;
    };
    const active = activeNode();
    const flags = (node) => (node === active ? FOCUSED : 0) | (tampered.has(node) ? TAMPERED : 0);
    const column = (get) => kept.map((index) => get(rows[index], index));
    return [[
      column(({ tag }) => tag), column(({ text }) => text), column(({ value }) => value),
      column(({ classes }) => classes), column(({ attributes }) => attributes),
      column(({ node }, index) => [refOf(node), parentOf(index), flags(node)]).flat(), column(({ box }) => box).flat(),
      all.length - kept.length,
    ], watched];
  }

  return {
    read, number, rectsOf, boxOf, offsetOf, named, isEditable, isDrawn, innerDocument, refOf,
    nodeOf: (ref) => nodes.get(ref), mark: (node) => { tampered.add(node); },
  };
})();
