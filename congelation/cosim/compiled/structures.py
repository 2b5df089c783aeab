"""The structures that the compiled loop works on, as in loop/structures.h."""

from __future__ import annotations

import ctypes

from congelation.cosim.coupling.points import KEPT
from congelation.cosim.recording import NODES

__all__ = [
    "Block",
    "Call",
    "Grid",
    "Integrator",
    "Loop",
    "Memory",
    "Part",
    "Plan",
    "Slave",
    "State",
]


class Call(ctypes.Structure):
    """One call that reads or sets Real values, or derivatives of them."""

    _fields_ = [
        ("plain", ctypes.c_void_p),
        ("ranked", ctypes.c_void_p),
        ("references", ctypes.c_void_p),
        ("orders", ctypes.c_void_p),
        ("note", ctypes.c_uint64),
        ("count", ctypes.c_size_t),
        ("values", ctypes.c_void_p),
        ("places", ctypes.c_void_p),
        ("factors", ctypes.c_void_p),
        ("offsets", ctypes.c_void_p),
    ]


class Slave(ctypes.Structure):
    """An FMU, and the calls that a step makes."""

    _fields_ = [
        ("component", ctypes.c_void_p),
        ("note", ctypes.c_void_p),
        ("step_note", ctypes.c_uint64),
        ("get_note", ctypes.c_uint64),
        ("free_note", ctypes.c_uint64),
        ("set_note", ctypes.c_uint64),
        ("step", ctypes.c_void_p),
        ("get_state", ctypes.c_void_p),
        ("free_state", ctypes.c_void_p),
        ("set_state", ctypes.c_void_p),
        ("states", ctypes.c_void_p * 2),
        ("reads", ctypes.POINTER(Call)),
        ("writes", ctypes.POINTER(Call)),
        ("holds", ctypes.POINTER(Call)),
        ("n_reads", ctypes.c_int),
        ("n_writes", ctypes.c_int),
        ("n_holds", ctypes.c_int),
        ("checked", ctypes.c_void_p),
        ("n_checked", ctypes.c_size_t),
        ("holds_some", ctypes.c_int),
        ("forward", ctypes.c_void_p),
        ("ahead", ctypes.c_void_p),
        ("steps_ahead", ctypes.c_int),
        ("reaches_end", ctypes.c_int),
    ]


class Block(ctypes.Structure):
    """Wires that are carried over together; Block of exchange.py."""

    _fields_ = [
        ("sources", ctypes.c_void_p),
        ("targets", ctypes.c_void_p),
        ("n_sources", ctypes.c_int),
        ("n_targets", ctypes.c_int),
        ("n", ctypes.c_ssize_t),
        ("places", ctypes.c_void_p),
        ("slots", ctypes.c_void_p),
        ("nominal", ctypes.c_void_p),
        ("loops", ctypes.c_int),
    ]


class Loop(ctypes.Structure):
    """What the compiled loop works on, and what became of it; as in loop/structures.h."""

    _fields_ = [
        ("slaves", ctypes.POINTER(Slave)),
        ("n_slaves", ctypes.c_int),
        ("which", ctypes.c_int),
        ("n_links", ctypes.c_ssize_t),
        ("Y", ctypes.c_void_p),
        ("C", ctypes.c_void_p),
        ("source", ctypes.c_void_p),
        ("source_derivative", ctypes.c_void_p),
        ("columns", ctypes.c_void_p),
        ("order", ctypes.c_void_p),
        ("inexact", ctypes.c_int),
        ("nominal", ctypes.c_void_p),
        ("blocks", ctypes.POINTER(Block)),
        ("solving", ctypes.c_void_p),
        ("n_blocks", ctypes.c_int),
        ("n_events", ctypes.c_int),
        ("events", ctypes.c_void_p),
        ("stop", ctypes.c_double),
        ("rows", ctypes.c_void_p),
        ("kinds", ctypes.c_void_p),
        ("recorded", ctypes.c_void_p),
        ("width", ctypes.c_ssize_t),
        ("capacity", ctypes.c_ssize_t),
        ("n_rows", ctypes.c_ssize_t),
        ("every", ctypes.c_long),
        ("left", ctypes.c_long),
        ("most", ctypes.c_long),
        ("steps", ctypes.c_long),
        ("rejected", ctypes.c_long),
        ("events_crossed", ctypes.c_long),
        ("floors", ctypes.c_long),
        ("passes", ctypes.c_long),
        ("calls", ctypes.c_long),
        ("largest_error", ctypes.c_double),
        ("counted", ctypes.c_double),
        ("counted_before", ctypes.c_double),
        ("status", ctypes.c_int),
        ("function", ctypes.c_char_p),
        ("time", ctypes.c_double),
        ("level", ctypes.c_int),
        ("n_judged", ctypes.c_ssize_t),
        ("judged", ctypes.c_void_p),
        ("judged_nominal", ctypes.c_void_p),
    ]


class Plan(ctypes.Structure):
    """What follows from a coupling and a system once and for all."""

    _fields_ = [
        ("iterates", ctypes.c_int),
        ("highest", ctypes.c_int),
        ("chooses", ctypes.c_int),
        ("accelerates", ctypes.c_int),
        ("max_iterations", ctypes.c_int),
        ("iterations", ctypes.c_int),
        ("saves", ctypes.c_int),
        ("halves", ctypes.c_int),
        ("sequential", ctypes.c_int),
        ("exchanges", ctypes.c_int),
        ("tolerance", ctypes.c_double),
        ("accuracy", ctypes.c_double),
        ("unsettled", ctypes.c_double),
        ("horizon", ctypes.c_double),
        ("first_change", ctypes.c_double),
        ("shortest_kept", ctypes.c_double),
        ("longest_at_rest", ctypes.c_double),
        ("n_back", ctypes.c_ssize_t),
        ("back", ctypes.c_void_p),
        ("work", ctypes.c_void_p),
    ]


class Grid(ctypes.Structure):
    """OutputGrid of recording.py, as far as it judges steps."""

    _fields_ = [
        ("interval", ctypes.c_double),
        ("n_sampled", ctypes.c_ssize_t),
        ("places", ctypes.c_void_p),
        ("nominal", ctypes.c_void_p),
        ("samples", ctypes.c_void_p),
        ("times", ctypes.c_double * NODES),
        ("n_times", ctypes.c_int),
    ]


class State(ctypes.Structure):
    """The state of a coupling at a communication point."""

    _fields_ = [
        ("times", ctypes.c_double * KEPT),
        ("n_times", ctypes.c_int),
        ("order", ctypes.c_int),
        ("table", ctypes.c_void_p),
        ("J", ctypes.c_void_p),
        ("length", ctypes.c_double),
    ]


class Memory(ctypes.Structure):
    """What a run takes from one step to the next."""

    _fields_ = [
        ("state", State),
        ("step", ctypes.c_double),
        ("error_before", ctypes.c_double),
        ("event", ctypes.c_double),
        ("refused_length", ctypes.c_double),
        ("refused_error", ctypes.c_double),
        ("sizes", ctypes.c_void_p),
        ("lasting", ctypes.c_void_p),
        ("found", ctypes.c_double),
        ("estimate", ctypes.c_double),
        ("jump", ctypes.c_double),
        ("kink", ctypes.c_double),
        ("left", ctypes.c_int),
        ("rejected", ctypes.c_int),
        ("n_grids", ctypes.c_int),
        ("grids", ctypes.POINTER(Grid)),
    ]


class Part(ctypes.Structure):
    """An FMU of model exchange, besides its Slave."""

    _fields_ = [
        ("set_time", ctypes.c_void_p),
        ("set_states", ctypes.c_void_p),
        ("get_rates", ctypes.c_void_p),
        ("get_indicators", ctypes.c_void_p),
        ("completed", ctypes.c_void_p),
        ("enter_event", ctypes.c_void_p),
        ("enter_continuous", ctypes.c_void_p),
        ("new_states", ctypes.c_void_p),
        ("get_states", ctypes.c_void_p),
        ("get_nominals", ctypes.c_void_p),
        ("time_note", ctypes.c_uint64),
        ("states_note", ctypes.c_uint64),
        ("rates_note", ctypes.c_uint64),
        ("indicators_note", ctypes.c_uint64),
        ("completed_note", ctypes.c_uint64),
        ("event_note", ctypes.c_uint64),
        ("n_states", ctypes.c_size_t),
        ("n_indicators", ctypes.c_size_t),
        ("first", ctypes.c_ssize_t),
        ("positive", ctypes.c_void_p),
    ]


class Integrator(ctypes.Structure):
    """All states of a system, and the method that integrates them."""

    _fields_ = [
        ("drive", ctypes.POINTER(Loop)),
        ("parts", ctypes.POINTER(Part)),
        ("n", ctypes.c_ssize_t),
        ("nominal", ctypes.c_void_p),
        ("tolerance", ctypes.c_double),
        ("step", ctypes.c_double),
        ("A", ctypes.c_void_p),
        ("B", ctypes.c_void_p),
        ("C", ctypes.c_void_p),
        ("E3", ctypes.c_void_p),
        ("E5", ctypes.c_void_p),
        ("D", ctypes.c_void_p),
        ("A_extra", ctypes.c_void_p),
        ("C_extra", ctypes.c_void_p),
        ("x", ctypes.c_void_p),
        ("x_old", ctypes.c_void_p),
        ("x_new", ctypes.c_void_p),
        ("K", ctypes.c_void_p),
        ("F", ctypes.c_void_p),
        ("work", ctypes.c_void_p),
        ("indicators", ctypes.c_void_p),
        ("t_old", ctypes.c_double),
        ("largest", ctypes.c_double),
        ("event", ctypes.c_double),
        ("Y_before", ctypes.c_void_p),
        ("n_Y", ctypes.c_ssize_t),
        ("leaves", ctypes.c_double),
        ("visits", ctypes.c_void_p),
        ("near", ctypes.c_double),
        ("n_visits", ctypes.c_long),
        ("visited", ctypes.c_long),
        ("rejected", ctypes.c_long),
        ("more", ctypes.c_int),
        ("restarts", ctypes.c_int),
        ("is_dense", ctypes.c_int),
        ("reached", ctypes.c_int),
        ("displaced", ctypes.c_int),
        ("ended", ctypes.c_int),
        ("in_event", ctypes.c_int),
    ]
