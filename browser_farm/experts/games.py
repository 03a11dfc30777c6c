"""Experts for tasks in which the page reacts randomly or plays: guessing, random numbers, prices, tic-tac-toe."""

from __future__ import annotations

import functools
import re

from browser_farm.experts.page_view import PageView, expert_for
from giirl_core.types import Action

LINES = ((0, 1, 2), (3, 4, 5), (6, 7, 8), (0, 3, 6), (1, 4, 7), (2, 5, 8), (0, 4, 8), (2, 4, 6))
RANDOM_MOVE_PROB = 0.55  # probability that the opponent moves uniformly at random
US, OPPONENT = 1, -1
Board = tuple[int, ...]  # nine cells: US, OPPONENT, or 0 if free


@expert_for("generate-number")
def generate_until_it_fits(view: PageView) -> Action:
    shown = next(view.page.text[row] for row in view.rows("div") if re.fullmatch(r"-|\d+", view.page.text[row]))
    bound = re.search(r"(less|greater) than (\d+)|(odd|even) number", view.instruction)
    assert bound is not None
    if shown == "-":
        fits = False
    elif bound[1]:
        fits = int(shown) < int(bound[2]) if bound[1] == "less" else int(shown) > int(bound[2])
    else:
        fits = int(shown) % 2 == (bound[3] == "odd")
    return view.click_button("Submit" if fits else "Generate")


@expert_for("guess-number")
def guess_by_counting(view: PageView) -> Action:
    """From 0 one up after each answer. Binary search is faster, but our nets do not tell "higher" from "lower"."""
    answer = re.search(r"than\s*(\d)", view.all_text(0))
    guess = 0 if answer is None else int(answer[1]) + 1
    return view.fill({view.row("input_number"): str(guess)}) or view.click_button("Submit")


@expert_for("stock-market")
def buy_when_it_is_cheap(view: PageView) -> Action:
    limit = float(view.extract(r"less than \$([\d.]+)\.$"))
    prices = [float(text[1:]) for text in view.page.text if re.fullmatch(r"\$[\d.]+", text)]
    return view.click_button("Buy") if prices and prices[0] < limit else view.wait()


@expert_for("tic-tac-toe")
def play_for_the_win(view: PageView) -> Action:
    """Play the move with the highest probability to win. The opponent is good enough that even this sometimes loses."""
    cells = [cell for line in view.rows(css_class="ttt-row") for cell in view.rows("span", inside=line)]
    board = tuple(_owner(view, cell) for cell in cells)
    return view.click(cells[max(_free(board), key=lambda cell: _win_probability(_put(board, cell, US)))])


def _owner(view: PageView, cell: int) -> int:
    if view.has_class(cell, "mark-x"):
        return US
    return OPPONENT if view.has_class(cell, "mark-o") else 0


def _free(board: Board) -> list[int]:
    return [cell for cell in range(9) if not board[cell]]


def _put(board: Board, cell: int, player: int) -> Board:
    return (*board[:cell], player, *board[cell + 1 :])


def _won(board: Board, player: int) -> bool:
    return any(all(board[cell] == player for cell in line) for line in LINES)


def _winning_moves(board: Board, player: int) -> list[int]:
    return [cell for cell in _free(board) if _won(_put(board, cell, player), player)]


@functools.cache
def _win_probability(board: Board) -> float:
    """Probability to win after our move. The opponent moves at random, or else wins or blocks if it can."""
    if _won(board, US):
        return 1.0
    replies = {cell: _win_probability_after_reply(_put(board, cell, OPPONENT)) for cell in _free(board)}
    if not replies:
        return 0.0
    random_reply = sum(replies.values()) / len(replies)
    careful = _winning_moves(board, OPPONENT) or _winning_moves(board, US) or list(replies)
    careful_term = (1 - RANDOM_MOVE_PROB) * sum(replies[cell] for cell in careful) / len(careful)
    return RANDOM_MOVE_PROB * random_reply + careful_term


def _win_probability_after_reply(board: Board) -> float:
    if _won(board, OPPONENT) or not _free(board):
        return 0.0
    return max(_win_probability(_put(board, cell, US)) for cell in _free(board))
