"""The complete state of an FMU instance as bytes, for fmi2SerializeFMUstate.

A header of fixed size (format, key of the model, SHA-256 of the body) and a body in JSON. Python
writes the shortest decimal that reads back as the same float, so the copy is exact to the bit.
Nothing is pickled: bytes from elsewhere cannot run code.
"""

from __future__ import annotations

import hashlib
import json

__all__ = ["NotAState", "from_bytes", "to_bytes"]

FORMAT = b"cgl1"
DIGEST = 32
HEADER = len(FORMAT) + 2 * DIGEST


class NotAState:
    """Stands for bytes that are no state of this model; setting it is refused with `reason`."""

    def __init__(self, data, reason):
        self.data = data
        self.reason = reason


def _key(model):
    return hashlib.sha256(model.encode("utf-8")).digest()


def to_bytes(model, state):
    """Serialise a state of `model` (its unique key), a JSON-like value."""
    if isinstance(state, NotAState):
        return state.data
    body = json.dumps(state, separators=(",", ":")).encode("ascii")
    return FORMAT + _key(model) + hashlib.sha256(body).digest() + body


def from_bytes(model, data):
    """The state that `data` holds, or a NotAState that says what is wrong with it."""
    head, body = data[:HEADER], data[HEADER:]
    if len(head) < HEADER or not head.startswith(FORMAT):
        return NotAState(data, f"{len(data)} bytes that are not a serialised FMU state")
    if head[len(FORMAT) : -DIGEST] != _key(model):
        return NotAState(data, "the serialised state of another model or build, not of " + model)
    if hashlib.sha256(body).digest() != head[-DIGEST:]:
        return NotAState(data, "a serialised state that was truncated or altered")
    return _tuples(json.loads(body.decode("ascii")))


def _tuples(value):
    """JSON's lists back to the tuples they were."""
    if isinstance(value, list):
        return tuple(_tuples(item) for item in value)
    return value
