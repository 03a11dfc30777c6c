// Reads the visible elements of a page as columns, and the colour, shape and attributes of some of them. Runs before page.js.
const reading = (() => {
  'use strict';

  // What MiniWoB adds to the task: instruction, reward display, start button, drawings of clicks.
  const NON_TASK_IDS = new Set(['query', 'reward-display', 'sync-task-cover', 'click-canvas', 'attention-canvas']);
  const INVISIBLE_TAGS = new Set(['script', 'style', 'br', 'head', 'link', 'meta', 'title', 'template', 'noscript']);
  const FOCUSED = 1, TAMPERED = 2;  // as in pages.py

  let tampered, refs, nodes;  // in this episode: nodes that were acted on, node -> ref, ref -> node

  function reset() {
    tampered = new WeakSet();
    refs = new WeakMap();
    nodes = [null];
  }

  reset();
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

  // An element that contains only floats has no height, but its content is visible.
  const overflows = (element) => element.firstElementChild !== null && element.getClientRects().length > 0
    && getComputedStyle(element).overflow === 'visible';

  // Text for screen readers only is in an element of one pixel that shows none of it.
  const isClipped = (element, box) => box.width <= 1 && box.height <= 1 && getComputedStyle(element).overflow === 'hidden';

  const collapse = (text) => text.replace(/\s+/g, ' ').trim().toWellFormed();

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

  // The columns of pages.decode_page. `numbers` holds ref, parent row and flags of each row, `details` row, colour,
  // shape and attributes of the elements that have any of the three.
  function walk() {
    const tag = [], text = [], value = [], classes = [], numbers = [], boxes = [], details = [];
    const active = document.activeElement;

    function addRow(node, parent, name, words, box) {
      const isText = name === 't';
      tag.push(name);
      text.push(words);
      value.push(isText ? '' : valueOf(node));
      classes.push(isText ? '' : node.getAttribute('class') || '');
      numbers.push(refOf(node), parent, (node === active ? FOCUSED : 0) | (tampered.has(node) ? TAMPERED : 0));
      boxes.push(box.left, box.top, box.width, box.height);
      if (!isText) addDetails(node, tag.length - 1);
      return tag.length - 1;
    }

    function addDetails(node, row) {
      const isSvg = node instanceof SVGElement, style = node.getAttribute('style');
      const colour = (style !== null && (node.style.backgroundColor || node.style.fill || node.style.color))
        || (isSvg && node.getAttribute('fill')) || (canvasPaths.has(node) && canvasPaths.get(node).colour) || '';
      const shape = isSvg || canvasPaths.has(node) ? shapeOf(node) : '';
      const attributes = collapse(attributesOf(node));
      if (colour || shape || attributes) details.push(row, colour, shape, attributes);
    }

    // One row for each line of the text as it is laid out.
    function addTextRows(node, parent) {
      const range = document.createRange();
      range.selectNodeContents(node);
      const rects = range.getClientRects();
      if (rects.length === 1) {
        if (rects[0].width > 0 && rects[0].height > 0) addRow(node, parent, 't', collapse(node.data), rects[0]);
        return;
      }
      let line = null;
      const endLine = () => { if (line) addRow(node, parent, 't', collapse(line.words.join(' ')), line.box()); };
      for (const word of node.data.matchAll(/\S+/g)) {
        range.setStart(node, word.index);
        range.setEnd(node, word.index + word[0].length);
        const rect = range.getClientRects()[0];
        if (!rect || rect.width === 0 || rect.height === 0) continue;
        if (!line || Math.abs(line.top - rect.top) > 1) {
          endLine();
          line = new Line(rect);
        }
        line.words.push(word[0]);
        line.right = Math.max(line.right, rect.right);
      }
      endLine();
    }

    function addOptions(select, parent) {
      // The options of a closed list are not drawn, but a person can select each of them.
      const box = select.getBoundingClientRect();
      for (const option of select.options) {
        const rect = option.getBoundingClientRect();
        addRow(option, parent, 'option', collapse(option.text), rect.width > 0 && rect.height > 0 ? rect : box);
      }
    }

    function visit(element, parent) {
      const name = element.localName.toLowerCase();
      if (INVISIBLE_TAGS.has(name) || NON_TASK_IDS.has(element.id)) return;
      const box = element.getBoundingClientRect();
      if (box.width === 0 || box.height === 0) {
        if (overflows(element)) visitChildren(element, parent);
        return;
      }
      if (isClipped(element, box)) return;
      const isInput = element instanceof HTMLInputElement;
      const isLeaf = element.firstElementChild === null;
      let row = parent;
      if (element.id !== 'wrap') {
        row = addRow(element, parent, isInput ? 'input_' + element.type : name,
          isLeaf && !isInput && name !== 'textarea' ? collapse(element.textContent) : '', box);
      }
      if (element instanceof HTMLSelectElement) addOptions(element, row);
      else if (!isLeaf || element.id === 'wrap') visitChildren(element, row);
    }

    function visitChildren(element, parent) {
      for (let node = element.firstChild; node !== null; node = node.nextSibling) {
        if (node.nodeType === 1) visit(node, parent);
        else if (node.nodeType === 3 && /\S/.test(node.data)) addTextRows(node, parent);
      }
    }

    visitChildren(document.body, -1);
    return [tag, text, value, classes, numbers, boxes, details];
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

  // ---- drawings

  const canvasPaths = new WeakMap();  // canvas -> the path that was drawn last: {colour, corners}

  function shapeOf(node) {
    if (canvasPaths.has(node)) return describe(canvasPaths.get(node).corners, node.getBoundingClientRect());
    if (node instanceof SVGPolygonElement || node instanceof SVGPolylineElement) {
      return describe([...node.points], matrixOf(node));
    }
    if (node instanceof SVGLineElement) {
      const [x1, y1, x2, y2] = [node.x1, node.y1, node.x2, node.y2].map((length) => length.baseVal.value);
      return describe([{ x: x1, y: y1 }, { x: x2, y: y2 }], matrixOf(node));
    }
    if (node instanceof SVGRectElement) return 'rectangle';
    if (node instanceof SVGCircleElement) return 'circle';
    return '';
  }

  const matrixOf = (node) => node.getScreenCTM() || new DOMMatrix();
  const SHAPES = ['', 'point', 'line', 'triangle', 'quadrilateral', 'pentagon', 'hexagon', 'heptagon', 'octagon'];

  // "triangle 10,40 20,20 30,40": the kind of polygon and its distinct corners, px from the page's upper left corner.
  // `origin` is the matrix of an SVG element, or the box of a canvas.
  function describe(points, origin) {
    const isMatrix = origin instanceof DOMMatrix || origin instanceof SVGMatrix;
    const onPage = points.map(({ x, y }) => (isMatrix
      ? new DOMPoint(x, y).matrixTransform(DOMMatrix.fromMatrix(origin)) : { x: x + origin.x, y: y + origin.y }))
      .map(({ x, y }) => `${Math.round(10 * x) / 10},${Math.round(10 * y) / 10}`);
    const corners = onPage.filter((corner, index) => onPage.indexOf(corner) === index);
    return [SHAPES[corners.length] || 'polygon', ...corners].join(' ');
  }

  // A canvas stores pixels, not shapes: record the path of its last stroke or fill.
  {
    const canvas = CanvasRenderingContext2D.prototype;
    const paths = new WeakMap();
    const { beginPath, moveTo, lineTo, stroke, fill } = canvas;
    const addCorner = (context, x, y) => {
      const path = paths.get(context);
      if (path) path.push(new DOMPoint(x, y).matrixTransform(context.getTransform()));
    };
    const recordPath = (context, colour) => {
      const corners = paths.get(context);
      if (corners && corners.length) {
        canvasPaths.set(context.canvas, { colour: String(colour), corners: [...corners] });
      }
    };
    canvas.beginPath = function recordedBeginPath() { paths.set(this, []); beginPath.call(this); };
    canvas.moveTo = function recordedMoveTo(x, y) { addCorner(this, x, y); moveTo.call(this, x, y); };
    canvas.lineTo = function recordedLineTo(x, y) { addCorner(this, x, y); lineTo.call(this, x, y); };
    canvas.stroke = function recordedStroke(...path) { recordPath(this, this.strokeStyle); stroke.apply(this, path); };
    canvas.fill = function recordedFill(...path) { recordPath(this, this.fillStyle); fill.apply(this, path); };
  }

  return { walk, collapse, reset, refOf, nodeOf: (ref) => nodes[ref] };
})();
