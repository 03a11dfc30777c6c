// The page as the miniwob package sees it: the page's own account of its DOM, laid out as columns. Joined in front of
// frame.js, which reads through it where a farm was opened with that view.
const elements = (() => {
  'use strict';

  const FOCUSED = 1, TAMPERED = 2, TARGETED = 4, LEAF = 8;

  function walk() {
    const tag = [], text = [], value = [], id = [], classes = [], numbers = [], boxes = [];
    const colours = new Map();
    const colour = (name) => {
      if (!colours.has(name)) colours.set(name, colours.size);
      return colours.get(name);
    };

    function row(node, parent) {
      // What has nothing but lines of text below it is a leaf with all of that text.
      const lines = node.children.length > 0 && node.children.every((child) => child.tag === 't');
      const words = lines ? node.children.map((child) => child.text).join(' ') : node.text;
      const here = tag.push(node.tag.toLowerCase()) - 1;
      text.push(words === undefined ? '' : String(words));
      value.push(node.value === undefined ? null : node.value);
      id.push(node.id === undefined ? '' : String(node.id));
      classes.push(typeof node.classes === 'object' ? 'SVG_CLASS' : node.classes || '');
      numbers.push(node.ref, parent, (node.focused ? FOCUSED : 0) | (node.tampered ? TAMPERED : 0)
        | (node.recordingTarget ? TARGETED : 0) | (words === undefined ? 0 : LEAF),
      colour(node.bgColor || ''), colour(node.fgColor || ''));
      boxes.push(node.left, node.top, node.width, node.height);
      if (!lines) for (const child of node.children) row(child, here);
    }

    const root = site().getDOMInfo();
    if (root) row(root, -1);
    return [said(), tag, text, value, id, classes, numbers, boxes, [...colours.keys()]];
  }

  // The flight tasks show a site in a frame, with an account of its own.
  const site = () => window.$miniwob || core;

  // A page says its instruction as a string, or as an object that brings the fields along.
  function said() {
    const words = (window.core || window.parent.core).getUtterance();
    return typeof words === 'object' && words !== null ? [words.utterance, Object.entries(words.fields)] : [words, null];
  }

  // The page writes refs and clicks on its elements with the number of the episode. The click that ended the last one
  // carries the number of the next.
  function forget() {
    reading.forget();
    core.endEpisode(0);
    WOB_EPISODE_ID += 1;
  }

  return { walk, forget, nodeOf: (ref) => (ref === 0 ? null : site().previousDOMInfo[ref]) };
})();
