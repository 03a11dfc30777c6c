// The visible elements of a page as columns, with the looks of what is drawn. Joined in front of page.js.
const reading = (() => {
  'use strict';

  const FURNITURE = new Set(['query', 'reward-display', 'sync-task-cover', 'click-canvas', 'attention-canvas']);
  const MUTE = new Set(['script', 'style', 'br', 'head', 'link', 'meta', 'title', 'template', 'noscript']);

  let tampered, refs, nodes;  // since the episode began: what was acted upon, node -> ref, ref -> node

  function forget() {
    tampered = new WeakSet();
    refs = new WeakMap();
    nodes = [null];
  }

  forget();
  for (const name of ['mousedown', 'click', 'wheel']) {
    window.addEventListener(name, (event) => { tampered.add(event.target); }, true);
  }

  function refOf(node) {
    let ref = refs.get(node);
    if (ref === undefined) {
      ref = nodes.push(node) - 1;
      refs.set(node, ref);
    }
    return ref;
  }

  // Floats leave the element around them without a height.
  const overflows = (element) => element.firstElementChild !== null && element.getClientRects().length > 0
    && getComputedStyle(element).overflow === 'visible';

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

  // What else tells an element from its like: as recordings have it, the id first.
  function attributesOf(node) {
    const words = [];
    for (const name of ['id', 'placeholder', 'alt', 'aria-label']) {
      const said = node.getAttribute(name);
      if (said) words.push(flat(said));
    }
    return words.join(' ');
  }

  function walk() {
    const tag = [], text = [], value = [], classes = [], numbers = [], boxes = [], looks = [];
    const active = document.activeElement;

    function row(node, parent, name, words, box) {
      const bare = name === 't';
      tag.push(name);
      text.push(words);
      value.push(bare ? '' : valueOf(node));
      classes.push(bare ? '' : node.getAttribute('class') || '');
      numbers.push(refOf(node), parent, (node === active ? 1 : 0) | (tampered.has(node) ? 2 : 0));
      boxes.push(box.left, box.top, box.width, box.height);
      if (!bare) look(node, tag.length - 1);
      return tag.length - 1;
    }

    function look(node, row) {
      const drawn = node instanceof SVGElement, style = node.getAttribute('style');
      const colour = (style !== null && (node.style.backgroundColor || node.style.fill || node.style.color))
        || (drawn && node.getAttribute('fill')) || (drawings.has(node) && drawings.get(node).colour) || '';
      const shape = drawn || drawings.has(node) ? shapeOf(node) : '';
      const attributes = attributesOf(node);
      if (colour || shape || attributes) looks.push(row, colour, shape, attributes);
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
      if (box.width === 0 || box.height === 0) {
        if (overflows(element)) children(element, parent);
        return;
      }
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
    return [tag, text, value, classes, numbers, boxes, looks];
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

  // ---- looks

  const drawings = new WeakMap();  // canvas -> the path it shows last: {colour, corners}

  function shapeOf(node) {
    if (drawings.has(node)) return named(drawings.get(node).corners, node.getBoundingClientRect());
    if (node instanceof SVGPolygonElement || node instanceof SVGPolylineElement) return named([...node.points], matrixOf(node));
    if (node instanceof SVGLineElement) {
      const [x1, y1, x2, y2] = [node.x1, node.y1, node.x2, node.y2].map((length) => length.baseVal.value);
      return named([{ x: x1, y: y1 }, { x: x2, y: y2 }], matrixOf(node));
    }
    if (node instanceof SVGRectElement) return 'rectangle';
    if (node instanceof SVGCircleElement) return 'circle';
    return '';
  }

  const matrixOf = (node) => node.getScreenCTM() || new DOMMatrix();
  const KINDS = ['', 'point', 'line', 'triangle', 'quadrilateral', 'pentagon', 'hexagon', 'heptagon', 'octagon'];

  // The corners where the page shows them, each once.
  function named(points, place) {
    const shown = points.map(({ x, y }) => (place instanceof DOMMatrix || place instanceof SVGMatrix
      ? new DOMPoint(x, y).matrixTransform(DOMMatrix.fromMatrix(place)) : { x: x + place.x, y: y + place.y }))
      .map(({ x, y }) => `${Math.round(10 * x) / 10},${Math.round(10 * y) / 10}`);
    const corners = shown.filter((corner, index) => shown.indexOf(corner) === index);
    return [KINDS[corners.length] || 'polygon', ...corners].join(' ');
  }

  // A canvas keeps no shapes, only paint: note the path it was given last.
  {
    const canvas = CanvasRenderingContext2D.prototype;
    const paths = new WeakMap();
    const { beginPath, moveTo, lineTo, stroke, fill } = canvas;
    const corner = (context, x, y) => {
      const path = paths.get(context);
      if (path) path.push(new DOMPoint(x, y).matrixTransform(context.getTransform()));
    };
    const shown = (context, colour) => {
      const corners = paths.get(context);
      if (corners && corners.length) drawings.set(context.canvas, { colour: String(colour), corners: [...corners] });
    };
    canvas.beginPath = function beginPathNoted() { paths.set(this, []); beginPath.call(this); };
    canvas.moveTo = function moveToNoted(x, y) { corner(this, x, y); moveTo.call(this, x, y); };
    canvas.lineTo = function lineToNoted(x, y) { corner(this, x, y); lineTo.call(this, x, y); };
    canvas.stroke = function strokeNoted(...path) { shown(this, this.strokeStyle); stroke.apply(this, path); };
    canvas.fill = function fillNoted(...path) { shown(this, this.fillStyle); fill.apply(this, path); };
  }

  return { walk, flat, forget, refOf, nodeOf: (ref) => nodes[ref] };
})();
