// The attributes that describe an element, space-separated: the column `attributes` of a page. The id is first, as in
// the human recordings.
const attributesOf = (element) => ['id', 'placeholder', 'alt', 'aria-label']
  .map((name) => (element.getAttribute(name) || '').trim()).filter(Boolean).join(' ');
