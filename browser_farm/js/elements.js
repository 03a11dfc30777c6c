// The page as the miniwob package sees it: the same elements with the same numbers and looks, laid out as columns.
// Joined in front of frame.js, which reads through it where a farm was opened with that view.
const elements = (() => {
  'use strict';

  const FOCUSED = 1, TAMPERED = 2, LEAF = 8;  // as in elements.py
  const FURNITURE = new Set(['reward-display', 'sync-task-cover', 'click-canvas', 'query']);
  const NUMBERS = 5, SIDES = 4;  // a row

  // The flight tasks show a site in a frame, which counts for itself and has no furniture.
  const site = () => window.$miniwob || core;
  const flight = () => '$miniwob' in window;
  // What stands beside a click and a ref, to tell this episode's from an earlier one's.
  const episode = () => (flight() ? 'e' : `e${WOB_EPISODE_ID}`);

  let nodes = new Map();  // ref -> element, of those shown last
  let rows, colours, now, active;

  function walk() {
    rows = { tag: [], text: [], value: [], id: [], classes: [], numbers: [], boxes: [] };
    colours = new Map();
    nodes = new Map();
    now = episode();
    active = document.activeElement;
    visit(document.body, -1);
    const { tag, text, value, id, classes, numbers, boxes } = rows;
    return [said(), tag, text, value, id, classes, numbers, boxes, [...colours.keys()]];
  }

  function colour(name) {
    let index = colours.get(name);
    if (index === undefined) {
      index = colours.size;
      colours.set(name, index);
    }
    return index;
  }

  function row(tag, text, value, id, classes, numbers, box) {
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
    if (known !== null && (flight() || element.getAttribute('data-wob_eps') === now)) return Number(known);
    const ref = site().nextRefCode;
    site().nextRefCode += 1;
    element.setAttribute('data-wob_ref', ref);
    if (!flight()) element.setAttribute('data-wob_eps', now);
    return ref;
  }

  function valueOf(element) {
    if (element instanceof HTMLInputElement) {
      return element.type === 'checkbox' || element.type === 'radio' ? element.checked : element.value;
    }
    return element instanceof HTMLTextAreaElement ? element.value : null;
  }

  function visit(element, parent) {
    if (!flight() && FURNITURE.has(element.id)) return false;
    const box = element.getBoundingClientRect();
    if (box.width === 0 || box.height === 0) return false;
    const tampered = element.getAttribute('data-tampered');
    const flags = (element === active ? FOCUSED : 0)
      | (tampered !== null && (flight() || tampered === now) ? TAMPERED : 0);
    const { backgroundColor, color } = getComputedStyle(element);
    const ref = refOf(element);
    const input = element instanceof HTMLInputElement ? `_${element.type}` : '';
    const { className } = element;
    const here = row((element.tagName + input).toLowerCase(), '', valueOf(element), String(element.id),
      typeof className === 'string' ? className : 'SVG_CLASS',
      [ref, parent, flags, colour(backgroundColor), colour(color)], box);
    nodes.set(ref, element);
    const words = element.firstElementChild === null ? ownWords(element) : below(element, here);
    if (words !== null) {
      rows.text[here] = words;
      rows.numbers[here * NUMBERS + 2] |= LEAF;
    }
    return true;
  }

  function ownWords(element) {
    const words = [];
    for (let node = element.firstChild; node !== null; node = node.nextSibling) {
      if (node.nodeType === Node.TEXT_NODE && /\S/.test(node.data)) words.push(node.data.trim());
    }
    return words.join(' ');
  }

  // Rows for all children. Where those are lines of text alone, the element itself is a leaf with these words.
  function below(element, here) {
    let inner = false;
    for (let node = element.firstChild; node !== null; node = node.nextSibling) {
      if (node.nodeType === Node.ELEMENT_NODE) inner = visit(node, here) || inner;
      else if (node.nodeType === Node.TEXT_NODE && /\S/.test(node.data)) lines(node, here);
    }
    const words = rows.text.slice(here + 1);
    if (inner || words.length === 0) return null;
    for (const name of ['tag', 'text', 'value', 'id', 'classes']) rows[name].length = here + 1;
    rows.numbers.length = (here + 1) * NUMBERS;
    rows.boxes.length = (here + 1) * SIDES;
    return words.join(' ');
  }

  // A row for each line that bare text takes; its refs count down and are new each time.
  function lines(node, parent) {
    const range = document.createRange();
    const rects = (start, end) => {
      range.setStart(node, start);
      range.setEnd(node, end);
      return range.getClientRects();
    };
    const length = node.data.length;
    for (let start = 0; start < length;) {
      let end = length, found = rects(start, end);
      if (found.length > 1) {  // the longest piece that stays on one line
        let low = start + 1, high = length - 1;
        while (low < high) {
          const middle = Math.ceil((low + high) / 2);
          if (rects(start, middle).length <= 1) low = middle;
          else high = middle - 1;
        }
        end = low;
        found = rects(start, end);
      }
      const text = node.data.slice(start, end).trim();
      if (found.length > 0 && found[0].width > 0 && found[0].height > 0 && text) {
        const ref = site().nextTextRefCode;
        site().nextTextRefCode -= 1;
        row('t', text, null, '', '', [ref, parent, LEAF, colour(''), colour('')], found[0]);
      }
      start = end;
    }
  }

  // A page says its instruction as a string, or as an object that brings the fields along.
  function said() {
    const words = (window.core || window.parent.core).getUtterance();
    return typeof words === 'object' && words !== null ? [words.utterance, fieldsOf(words.fields)] : [words, null];
  }

  // In the order of their names: so chromedriver hands them to the package.
  const fieldsOf = (named) => Object.entries(named).sort(([one], [other]) => (one < other ? -1 : 1));

  // The page notes clicks that come up to its body, until the farm quiets it.
  function note(event) {
    event.target.setAttribute('data-tampered', episode());
  }

  // The click that ended the last episode carries the number of the next.
  function forget() {
    reading.forget();
    if (!core.flightChildWindow) document.body.addEventListener('click', note);
    core.endEpisode(0);
    WOB_EPISODE_ID += 1;
  }

  return { walk, forget, nodeOf: (ref) => (ref === 0 ? null : nodes.get(ref)) };
})();
