"""Pages that answer back: guesses, draws, cards, a game."""

from __future__ import annotations

import functools
import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

LINES = ((0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6))
CARELESS = 0.55  # how often the other player moves by chance
US, THEM = 1, -1
Board = tuple[int, ...]  # nine cells: 1 ours, -1 theirs, 0 free


@expert_for("generate-number")
def generate_until_it_fits(see: PageView) -> Action:
    shown = next(see.page.text[row] for row in see.rows("div") if re.fullmatch(r"-|\d+", see.page.text[row]))
    bound = re.search(r"(less|greater) than (\d+)|(odd|even) number", see.said)
    assert bound is not None
    if shown == "-":
        fits = False
    elif bound[1]:
        fits = int(shown) < int(bound[2]) if bound[1] == "less" else int(shown) > int(bound[2])
    else:
        fits = int(shown) % 2 == (bound[3] == "odd")
    return see.press_button("Submit" if fits else "Generate")


@expert_for("guess-number")
def guess_by_halves(see: PageView) -> Action:
    """Each number has one place in the tree of halves, so the last answer alone says where the search is."""
    field = see.row("input_number")
    text = see.reading(0)
    low, high = 0, 9
    answer = re.search(r"(lower|higher) than\s*(\d)", text)
    while answer is not None:
        middle = (low + high) // 2
        known = int(answer[2])
        if known == middle:
            low, high = (low, known - 1) if answer[1] == "lower" else (known + 1, high)
            break
        low, high = (low, middle - 1) if known < middle else (middle + 1, high)
    guess = str((low + high) // 2)
    return see.fill({field: guess}) or see.press_button("Submit")


@expert_for("stock-market")
def buy_when_it_is_cheap(see: PageView) -> Action:
    limit = float(see.words(r"less than \$([\d.]+)\.$"))
    prices = [float(text[1:]) for text in see.page.text if re.fullmatch(r"\$[\d.]+", text)]
    return see.press_button("Buy") if prices and prices[0] < limit else see.wait()


@expert_for("tic-tac-toe")
def play_for_the_win(see: PageView) -> Action:
    """Best play: the other player is careless only half of the time, so even it does not always win."""
    cells = [cell for line in see.rows(kind="ttt-row") for cell in see.rows("span", inside=line)]
    board = tuple(US if see.has(cell, "mark-x") else THEM if see.has(cell, "mark-o") else 0 for cell in cells)
    return see.click(cells[max(_free(board), key=lambda cell: _worth(_put(board, cell, US)))])


def _free(board: Board) -> list[int]:
    return [cell for cell in range(9) if not board[cell]]


def _put(board: Board, cell: int, who: int) -> Board:
    return (*board[:cell], who, *board[cell + 1 :])


def _won(board: Board, who: int) -> bool:
    return any(all(board[cell] == who for cell in line) for line in LINES)


def _completing(board: Board, who: int) -> list[int]:
    return [cell for cell in _free(board) if _won(_put(board, cell, who), who)]


@functools.cache
def _worth(board: Board) -> float:
    """How likely we are to win after our move: the other player wins, blocks or moves by chance."""
    if _won(board, US):
        return 1.0
    replies = {cell: _after(_put(board, cell, THEM)) for cell in _free(board)}
    if not replies:
        return 0.0
    chance = sum(replies.values()) / len(replies)
    careful = _completing(board, THEM) or _completing(board, US) or list(replies)
    return CARELESS * chance + (1 - CARELESS) * sum(replies[cell] for cell in careful) / len(careful)


def _after(board: Board) -> float:
    if _won(board, THEM) or not _free(board):
        return 0.0
    return max(_worth(_put(board, cell, US)) for cell in _free(board))
