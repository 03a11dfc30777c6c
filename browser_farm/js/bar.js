// The bar beside a recorded page: a document of its own. All texts are set as text, never as HTML.
(() => {
  'use strict';

  const style = document.createElement('style');
  style.textContent = `
    body { font: 16px/1.4 system-ui, sans-serif; margin: 0; padding: 12px 16px; color: #1b1b1b; background: #fff8e1; }
    #instruction { font-size: 20px; font-weight: 600; margin: 4px 0 8px; overflow-wrap: anywhere; }
    #buttons { position: sticky; top: 0; }
    #note { color: #7a1f00; margin: 8px 0 0; overflow-wrap: anywhere; }
    button { font: inherit; padding: 6px 14px; margin: 0 8px 6px 0; }
    @media (prefers-color-scheme: dark) { body { color: #f3f3f3; background: #2b2415; } #note { color: #ffb59b; } }`;
  document.head.replaceChildren(style);
  document.title = 'Recording';

  const add = (tag, id) => document.body.appendChild(Object.assign(document.createElement(tag), { id }));
  document.body.replaceChildren();
  const progress = add('div', 'progress'), instruction = add('div', 'instruction'), note = add('div', 'note');
  const buttons = add('div', 'buttons');
  document.body.prepend(buttons);  // they stay in view beside a long instruction
  note.setAttribute('role', 'status');

  // `state`: {progress, instruction, note, buttons: [[choice, label], ...]}
  window.show = (state) => {
    progress.textContent = state.progress;
    instruction.textContent = state.instruction;
    note.textContent = state.note;
    const labels = state.buttons.map(([, label]) => label).join();
    if (buttons.dataset.labels === labels) return;  // a button must not vanish under the mouse
    buttons.dataset.labels = labels;
    buttons.replaceChildren(...state.buttons.map(([choice, label]) => {
      const button = Object.assign(document.createElement('button'), { id: choice, textContent: label });
      button.addEventListener('click', () => giirlChoose(choice));
      return button;
    }));
  };
})();
