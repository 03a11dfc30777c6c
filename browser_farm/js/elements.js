// Reads a page as the miniwob package does: the same elements, refs and styles, as columns. Runs before frame.js, which
// uses it in a farm that was opened with the ELEMENTS view.
const elements = (() => {
  'use strict';

  const FOCUSED = 1, TAMPERED = 2, LEAF = 8;  // as in elements.py
  const NON_TASK_IDS = new Set(['reward-display', 'sync-task-cover', 'click-canvas', 'query']);
  const NUMBERS_PER_ROW = 5, BOX_NUMBERS_PER_ROW = 4;

  // The flight tasks show a site in an iframe, which has its own ref counters and no elements to skip.
  const counters = () => window.$miniwob || core;
  const isFlight = () => '$miniwob' in window;
  // Refs and clicks are stored in attributes with this mark, which tells the episodes apart.
  const episodeMark = () => (isFlight() ? 'e' : `e${WOB_EPISODE_ID}`);

  let nodes = new Map();  // ref -> element, from the last walk
  let rows, colours, mark, active;

  // The columns of elements.decode_elements. `numbers` holds ref, parent row, flags, background and foreground of each
  // row; the last two are indices into the colours.
  function walk() {
    rows = { tag: [], text: [], value: [], id: [], classes: [], numbers: [], boxes: [] };
    colours = new Map();
    nodes = new Map();
    mark = episodeMark();
    active = document.activeElement;
    visit(document.body, -1);
    const { tag, text, value, id, classes, numbers, boxes } = rows;
    return [instruction(), tag, text, value, id, classes, numbers, boxes, [...colours.keys()]];
  }

  function colourIndex(name) {
    let index = colours.get(name);
    if (index === undefined) {
      index = colours.size;
      colours.set(name, index);
    }
    return index;
  }

  function addRow(tag, text, value, id, classes, numbers, box) {
    rows.text.push(text);
    rows.value.push(value);
    rows.id.push(id);
    rows.classes.push(classes);
    rows.numbers.push(...numbers);
    rows.boxes.push(box.left, box.top, box.width, box.height);
    return rows.tag.push(tag) - 1;
  }

  function refOf(element) {
    const known = element.getAttribute('data-wob_ref');
    if (known !== null && (isFlight() || element.getAttribute('data-wob_eps') === mark)) return Number(known);
    const ref = counters().nextRefCode;
    counters().nextRefCode += 1;
    element.setAttribute('data-wob_ref', ref);
    if (!isFlight()) element.setAttribute('data-wob_eps', mark);
    return ref;
  }

  function valueOf(element) {
    if (element instanceof HTMLInputElement) {
      return element.type === 'checkbox' || element.type === 'radio' ? element.checked : element.value;
    }
    return element instanceof HTMLTextAreaElement ? element.value : null;
  }

  // Add rows for an element and everything in it; false if it is not visible.
  function visit(element, parent) {
    if (!isFlight() && NON_TASK_IDS.has(element.id)) return false;
    const box = element.getBoundingClientRect();
    if (box.width === 0 || box.height === 0) return false;
    const tampered = element.getAttribute('data-tampered');
    const flags = (element === active ? FOCUSED : 0)
      | (tampered !== null && (isFlight() || tampered === mark) ? TAMPERED : 0);
    const { backgroundColor, color } = getComputedStyle(element);
    const ref = refOf(element);
    const inputType = element instanceof HTMLInputElement ? `_${element.type}` : '';
    const { className } = element;
    const row = addRow((element.tagName + inputType).toLowerCase(), '', valueOf(element), String(element.id),
      typeof className === 'string' ? className : 'SVG_CLASS',
      [ref, parent, flags, colourIndex(backgroundColor), colourIndex(color)], box);
    nodes.set(ref, element);
    const text = element.firstElementChild === null ? ownText(element) : visitChildren(element, row);
    if (text !== null) {
      rows.text[row] = text;
      rows.numbers[row * NUMBERS_PER_ROW + 2] |= LEAF;
    }
    return true;
  }

  function ownText(element) {
    const parts = [];
    for (let node = element.firstChild; node !== null; node = node.nextSibling) {
      if (node.nodeType === Node.TEXT_NODE && /\S/.test(node.data)) parts.push(node.data.trim());
    }
    return parts.join(' ');
  }

  // Add rows for all children. If they are only lines of text, the element itself is a leaf: their rows are removed
  // and their text is returned.
  function visitChildren(element, row) {
    let hasElements = false;
    for (let node = element.firstChild; node !== null; node = node.nextSibling) {
      if (node.nodeType === Node.ELEMENT_NODE) hasElements = visit(node, row) || hasElements;
      else if (node.nodeType === Node.TEXT_NODE && /\S/.test(node.data)) addTextRows(node, row);
    }
    const texts = rows.text.slice(row + 1);
    if (hasElements || texts.length === 0) return null;
    for (const name of ['tag', 'text', 'value', 'id', 'classes']) rows[name].length = row + 1;
    rows.numbers.length = (row + 1) * NUMBERS_PER_ROW;
    rows.boxes.length = (row + 1) * BOX_NUMBERS_PER_ROW;
    return texts.join(' ');
  }

  // Add a row for each line of a text node. Their refs are negative and new in each walk.
  function addTextRows(node, parent) {
    const range = document.createRange();
    const rectsOf = (start, end) => {
      range.setStart(node, start);
      range.setEnd(node, end);
      return range.getClientRects();
    };
    const length = node.data.length;
    for (let start = 0; start < length;) {
      let end = length, rects = rectsOf(start, end);
      if (rects.length > 1) {  // binary search for the longest part that fits on one line
        let low = start + 1, high = length - 1;
        while (low < high) {
          const middle = Math.ceil((low + high) / 2);
          if (rectsOf(start, middle).length <= 1) low = middle;
          else high = middle - 1;
        }
        end = low;
        rects = rectsOf(start, end);
      }
      const text = node.data.slice(start, end).trim();
      if (rects.length > 0 && rects[0].width > 0 && rects[0].height > 0 && text) {
        const ref = counters().nextTextRefCode;
        counters().nextTextRefCode -= 1;
        addRow('t', text, null, '', '', [ref, parent, LEAF, colourIndex(''), colourIndex('')], rects[0]);
      }
      start = end;
    }
  }

  // [utterance, fields]. A page returns its instruction as a string, or as an object that also has the fields.
  function instruction() {
    const utterance = (window.core || window.parent.core).getUtterance();
    if (typeof utterance !== 'object' || utterance === null) return [utterance, null];
    return [utterance.utterance, sortedFields(utterance.fields)];
  }

  // Sorted by name, the order in which chromedriver returns them to the package.
  const sortedFields = (fields) => Object.entries(fields).sort(([one], [other]) => (one < other ? -1 : 1));

  // MiniWoB marks clicks that bubble up to the body, with a listener that page.js removes.
  function markClick(event) {
    event.target.setAttribute('data-tampered', episodeMark());
  }

  // The click that ends an episode is marked with the number of the next one, so that number is skipped.
  function reset() {
    reading.reset();
    if (!core.flightChildWindow) document.body.addEventListener('click', markClick);
    core.endEpisode(0);
    WOB_EPISODE_ID += 1;
  }

  // The ref of a node in the last walk; 0 for one that has none.
  function refIn(node) {
    const ref = node instanceof Element ? Number(node.getAttribute('data-wob_ref')) : 0;
    return nodes.get(ref) === node ? ref : 0;
  }

  return { walk, reset, refIn, nodeOf: (ref) => (ref === 0 ? null : nodes.get(ref)) };
})();

// The same, and then the columns of reading.walk(), with the refs of the elements.
const elementsAndRows = {
  ...elements,
  walk() {
    const columns = elements.walk(), rows = reading.walk(), numbers = rows[4];
    for (let at = 0; at < numbers.length; at += 3) numbers[at] = elements.refIn(reading.nodeOf(numbers[at]));
    return [...columns, rows];
  },
};
