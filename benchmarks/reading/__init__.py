"""How well the nets read pages: the next action on recordings that were held out."""
