"""A task on a page of one's own: a list of guests, to which a name is added."""

from __future__ import annotations

PAGE = """<!DOCTYPE html><h1>Guests</h1><label>Name <input id=name></label><button onclick="add()">Add</button>
<button>Clear</button><ul id=list></ul><script>
function add() { const item = document.createElement('li'); item.textContent = document.getElementById('name').value;
  list.append(item); }</script>"""
TASK = """
address = "guests.html"
instructions = 'Add the guest "{name}".'
viewport = [640, 400]
expert = "experts.py:add"
[fields]
name = ["Ada", "Grace", "Edsger", "Barbara", "Tony", "Radia", "Ken", "Hedy"]
[end]
selector = "#list li"
"""
SUCCESS = "[success]\nscript = \"document.querySelector('#list li').textContent === {name}\"\n"
EXPERT = """
def add(view):
    field = view.row("input_text", "Name")
    return view.fill({field: view.quoted()[0]}) or view.click_button("Add")
"""
