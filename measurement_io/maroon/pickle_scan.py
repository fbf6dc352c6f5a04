"""Look at a pickle before it is loaded: which opcodes, which names, how deep, how much.

The C unpickler trusts lengths and indices: one `LONG_BINPUT` of ten bytes makes it allocate
gigabytes, nested tuples as a dictionary key make it overflow the stack or hash for ever. So the
opcodes are walked first, without building anything, and only what `numpy.save` writes for a
dictionary of arrays passes.
"""

from __future__ import annotations

import pickletools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

# fmt: off
ALLOWED_OPCODES = frozenset([
    "PROTO", "FRAME", "STOP", "MARK", "MEMOIZE", "BINPUT", "LONG_BINPUT", "BINGET",
    "LONG_BINGET", "GLOBAL", "STACK_GLOBAL", "REDUCE", "BUILD", "NONE", "NEWTRUE",
    "NEWFALSE", "BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT", "BINUNICODE",
    "SHORT_BINUNICODE", "BINUNICODE8", "BINSTRING", "SHORT_BINSTRING", "BINBYTES",
    "SHORT_BINBYTES", "BINBYTES8", "BYTEARRAY8", "EMPTY_TUPLE", "TUPLE", "TUPLE1", "TUPLE2",
    "TUPLE3", "EMPTY_LIST", "APPEND", "APPENDS", "EMPTY_DICT", "SETITEM", "SETITEMS",
])
# fmt: on
MAX_OPERATIONS = 500_000
"""A frame needs some hundreds; a list of a hundred thousand time stamps still fits."""

MAX_KEY_ITEMS = 100
"""Most items in a key of a dictionary: a key is hashed again each time it is used."""

MAX_DEPTH = 60
"""Deepest nesting; a frame has about ten levels."""

MAX_ITEMS = 2_000_000
"""Most items when every shared reference is counted each time it is reached."""


class UnsafePickle(Exception):
    """The pickle holds something that a recorded frame does not need; the text says what."""


@dataclass(frozen=True, slots=True)
class _Item:
    """What is known of an object on the pickle's stack: its size, its depth, and short strings."""

    items: int = 1
    depth: int = 0
    text: str | None = None


_MARK = _Item(text="\x00mark")
_LEAF = _Item()
_FRAME_HEADER = 9


def scan(data: bytes, check_name: Callable[[str, str], None]) -> None:
    """Walk the opcodes of `data` and raise `UnsafePickle` at the first that is not allowed.

    Parameters
    ----------
    data : bytes
        One pickle, from its first to its last byte.
    check_name : callable
        Called with (module, name) for every global that the pickle asks for; raises to refuse.
    """
    stack: list[_Item] = []
    memo: dict[int, _Item] = {}
    frame_end: int | None = None
    operations: Iterator[tuple[Any, Any, Any]] = pickletools.genops(data)
    for count, (opcode, argument, position) in enumerate(operations, start=1):
        if count > MAX_OPERATIONS:
            raise UnsafePickle(f"more than {MAX_OPERATIONS} pickle operations")
        name = opcode.name
        # The C unpickler drops what is left of a frame when an operation reaches over its end. It
        # would then see other operations than this walk, so frames have to end where one ends.
        if frame_end is not None and position >= frame_end:
            if position > frame_end:
                raise UnsafePickle("a pickle frame that ends inside an operation")
            frame_end = None
        if name in ("GLOBAL", "INST"):
            check_name(*str(argument).split(" ", 1))
        if name not in ALLOWED_OPCODES:
            raise UnsafePickle(
                f"the pickle operation {name} at byte {position} (frames are written with "
                "protocol 2 to 5 and need no more than numbers, strings, arrays and dictionaries)"
            )
        if name == "PROTO" and not 2 <= argument <= 5:
            raise UnsafePickle(f"pickle protocol {argument} (2 to 5 are read)")
        if name in ("BINPUT", "LONG_BINPUT", "MEMOIZE"):
            slot = len(memo) if name == "MEMOIZE" else argument
            if slot > count:
                # Python's pickler numbers its memo 0, 1, 2 ...; the loader allocates up to it.
                raise UnsafePickle(f"memo entry {slot} after {count} pickle operations")
            memo[slot] = _top(stack)
        elif name in ("BINGET", "LONG_BINGET"):
            if argument not in memo:
                raise UnsafePickle(f"memo entry {argument}, which was never stored")
            stack.append(memo[argument])
        elif name == "MARK":
            stack.append(_MARK)
        elif name == "STOP":
            if len(stack) != 1 or stack[0] is _MARK:
                raise UnsafePickle("a pickle that stops in the middle")
            if position + 1 != len(data):
                raise UnsafePickle(f"{len(data) - position - 1} bytes after the end of the pickle")
            if frame_end not in (None, len(data)):
                raise UnsafePickle("a pickle frame that ends behind the pickle")
        elif name == "FRAME":
            if frame_end is not None:
                raise UnsafePickle("a pickle frame inside another")
            frame_end = position + _FRAME_HEADER + argument
        elif name != "PROTO":
            _step(stack, name, opcode, argument, check_name)


def _step(
    stack: list[_Item],
    name: str,
    opcode: pickletools.OpcodeInfo,
    argument: Any,
    check_name: Callable[[str, str], None],
) -> None:
    """Apply what the opcode does to the stack, as pickletools describes it."""
    taken: list[_Item] = []
    before = opcode.stack_before
    if pickletools.markobject in before:
        while _top(stack, allow_mark=True) is not _MARK:
            taken.append(stack.pop())
        stack.pop()
        before = before[: before.index(pickletools.markobject)]
    for _ in before:
        taken.append(_top(stack))
        stack.pop()
    if name == "STACK_GLOBAL":
        attribute, module = taken[0].text, taken[1].text
        if attribute is None or module is None:
            raise UnsafePickle("a name that is no string")
        check_name(module, attribute)
    if not taken:
        stack.append(_leaf(argument))
        return
    items = 1 + sum(item.items for item in taken)
    depth = 1 + max(item.depth for item in taken)
    if name in ("APPEND", "APPENDS", "SETITEM", "SETITEMS"):
        # The container was on the stack already: filling it adds a level only below its items.
        if name.startswith("SETITEM") and any(k.items > MAX_KEY_ITEMS for k in taken[1:-1:2]):
            raise UnsafePickle(f"a dictionary key of more than {MAX_KEY_ITEMS} items")
        depth = max(taken[-1].depth, 1 + max((item.depth for item in taken[:-1]), default=0))
    if items > MAX_ITEMS:
        raise UnsafePickle(f"more than {MAX_ITEMS} items through shared references")
    if depth > MAX_DEPTH:
        raise UnsafePickle(f"more than {MAX_DEPTH} levels of nesting")
    stack.append(_Item(items, depth))


def _leaf(argument: Any) -> _Item:
    if isinstance(argument, str) and len(argument) <= 200:
        return _Item(text=argument)
    if isinstance(argument, int):
        return _Item(items=1 + argument.bit_length() // 64)
    return _LEAF


def _top(stack: list[_Item], *, allow_mark: bool = False) -> _Item:
    if not stack or (stack[-1] is _MARK and not allow_mark):
        raise UnsafePickle("a pickle whose operations do not fit together")
    return stack[-1]
