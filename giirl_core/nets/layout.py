"""The columns of the feature arrays: which number of an element or goal token is where, and how many there are."""

from __future__ import annotations

WORDS = 14  # words of an element that the nets read: the first ones of its text, then of its value
KIND_WORDS = 8  # words for the kind of an element, from its tag, shape, colour, classes and attributes
TAGS = 128  # hash buckets of tag names
CLASSES = 64  # hash buckets of class names, 0 for none
CLASS_SLOTS = 3  # class names of an element that the nets read
GOAL_NUMBERS = 3  # numbers of the goal that elements are compared with: the first ones
WIDTH_PX, HEIGHT_PX = 160.0, 210.0  # of a MiniWoB page

# Columns of Features.element_ids.
ELEMENT_WORDS = slice(0, WORDS)
ELEMENT_KIND = slice(WORDS, WORDS + KIND_WORDS)
TAG = WORDS + KIND_WORDS
CLASS = slice(TAG + 1, TAG + 1 + CLASS_SLOTS)
CLICKABLE, TYPABLE = TAG + 1 + CLASS_SLOTS, TAG + 2 + CLASS_SLOTS
ELEMENT_IDS = TAG + 3 + CLASS_SLOTS

# Kinds of match between an element and words of the goal: the whole text of the element, any of its words, its whole
# value, any word of its kind, all its attributes, the whole text or any word of its label, the whole text of another
# element in its row of a table, a similar word, and a similar word that no other element matches better.
TEXT_RUN, TEXT_WORD, VALUE_RUN, KIND_WORD, ATTRIBUTE_RUN, LABEL_RUN, LABEL_WORD, GROUP_RUN, SIMILAR, MOST_SIMILAR = (
    range(10)
)
MATCH_KINDS = 10

# Columns of Features.element_flags that do not depend on the goal.
POSITION = slice(0, 4)  # left, top, width and height as fractions of a page
FOCUSED, TAMPERED, LEAF, IS_FIELD, HAS_TEXT, HAS_VALUE, CHECKED = range(4, 11)
RANK = slice(11, 16)  # one-hot: 1st to 5th of the elements with the same tag and class
RANK_LAST, RANK_ONLY, ALIKE_COUNT = 16, 17, 18  # the last or the only one; logarithm of their number
SIZE = slice(19, 21)  # logarithms of width and height relative to the largest leaf
NAMES_KIND, KIND_NAMED = 21, 22  # its only word names the kind of another element; the other way round
ACTED_COUNT = 23  # log(1 + number of leaves that were acted on), the same for all elements
HAS_NUMBER, NUMBER = 24, 25  # its text or value is a number; the number / 10
LEAST, MOST = 26, 27  # it has the smallest or largest numbers of the elements with the same tag and classes
LABELLED, GROUPED = 28, 29  # it has a label; it is in a row of a table
PAGE_FLAGS = 30
# Columns of Features.element_flags that compare element and goal.
MATCHED = slice(30, 30 + MATCH_KINDS)  # of each kind
MATCHED_QUOTED = slice(30 + MATCH_KINDS, 30 + 2 * MATCH_KINDS)  # of each kind, between quotes
_NEXT = 30 + 2 * MATCH_KINDS
TEXT_FOLDED = _NEXT  # the goal contains the whole text in any case
WORD_FRACTION = _NEXT + 1  # fraction of the element's words that are in the goal
PREFIX, SUFFIX = _NEXT + 2, _NEXT + 3  # its text, or else its value, begins or ends with a quoted word of the goal
SIMILARITY, LABEL_SIMILARITY = _NEXT + 4, _NEXT + 5  # from 0 to 2: to the MOST_SIMILAR word of it, of its label
RANK_IN_GOAL = _NEXT + 6  # its rank is a number of the goal
CALENDAR = slice(_NEXT + 7, _NEXT + 11)  # the page shows a month; it is the goal's; the goal's is later; is earlier
FITS, COUNTS_FITTING = _NEXT + 11, _NEXT + 12  # a drawing as the goal describes; its text is the number of these
PEER, HAS_PEER = _NEXT + 13, _NEXT + 14  # not acted on, but matches like an element that was; the page has one
COMPARED = _NEXT + 15  # for each number of the goal, the columns EQUAL to WANTED
EQUAL, SIGN, DISTANCE, RANK_EQUAL, ACTED_EQUAL, ACTED_SIGN, WANTED, PER_NUMBER = range(8)
ELEMENT_FLAGS = COMPARED + PER_NUMBER * GOAL_NUMBERS
ELEMENT_OVERLAP = slice(PAGE_FLAGS, ELEMENT_FLAGS)

# Columns of Features.token_ids.
WORD, OPEN, TOKEN_IDS = 0, 1, 2
# Columns of Features.token_flags: 3 on the page; 4 in a value; 6-10 in other matches (TOKEN_MATCHES). DONE: a leaf that
# it names was acted on. NEXT: it is one more than a number on the page.
QUOTE, PUNCTUATION, CAPITAL, ON_PAGE, IN_VALUE, QUOTED = range(6)
TOKEN_MATCHES = slice(6, 11)
DIGIT, DONE, NEXT, TOKEN_FLAGS = 11, 12, 13, 14
TOKEN_OVERLAP = (ON_PAGE, IN_VALUE, *range(6, 11), DONE, NEXT)

TREE_RELATIONS = 11  # relations of two elements in the tree
SCREEN_RELATIONS = 8  # relations of two elements on the screen
RELATIONS = TREE_RELATIONS * SCREEN_RELATIONS
