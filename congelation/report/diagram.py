"""The system as a diagram: components as boxes, connections as arrows with what they carry."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

from congelation.results.labels import plain_unit

__all__ = ["diagram"]

BOX, HEIGHT, GAP, LANE, MARGIN = 190, 46, 44, 12, 50  # pixels


def diagram(about: Mapping[str, Any]) -> Iterator[str]:
    """An SVG drawing, and the connections as a table; nothing where none were stored.

    Components stand below each other in the order of the scenario; what goes down passes on the
    right, what goes up on the left.
    """
    connections: Sequence[Mapping[str, str]] = about.get("connections", ())
    if not connections:
        return
    fmus: Mapping[str, Mapping[str, str]] = about["fmus"]
    places = {name: k * (HEIGHT + GAP) for k, name in enumerate(fmus)}
    wires: dict[tuple[str, str], list[str]] = {}
    for connection in connections:
        source, _, carried = connection["source"].partition(".")
        target, _, taken = connection["target"].partition(".")
        unit = plain_unit(connection["unit"])
        text = carried if carried == taken else f"{carried} → {taken}"
        wires.setdefault((source, target), []).append(f"{text} [{unit}]" if unit else text)
    lanes = max(len(wires) - 1, 1) * LANE
    widest = max(len(", ".join(texts)) for texts in wires.values())
    side = max(MARGIN, 8 * widest) + 24 + lanes
    width, height = BOX + 2 * side, places[[*fmus][-1]] + HEIGHT + 2
    names = ", ".join(fmus)
    yield f'<div class="scroll" tabindex="0" role="region" aria-label="Diagram of {escape(names)}">'
    yield (
        f'<svg class="diagram" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        f'role="img" aria-label="Diagram of {escape(names)}; the table below has its connections">'
    )
    lane = {True: 0, False: 0}
    for (source, target), texts in wires.items():
        down = places[target] >= places[source]
        depth = 18 + LANE * lane[down]
        lane[down] += 1
        edge = side + BOX if down else side
        x = edge + depth if down else edge - depth
        # Arrows leave in the lower half of a box and arrive in the upper one, or the reverse.
        shift = 6 if down else -6
        start = places[source] + HEIGHT / 2 + shift
        stop = places[target] + HEIGHT / 2 - shift
        tip = 7 if down else -7
        yield f'<path class="wire" d="M{edge} {start} H{x} V{stop} H{edge}"/>'
        yield f'<path class="tip" d="M{edge} {stop} l{tip} -4 v8 z"/>'
        middle, anchor = (start + stop) / 2 + 5, "start" if down else "end"
        yield (
            f'<text x="{x + (6 if down else -6)}" y="{middle}" text-anchor="{anchor}">'
            f"{escape(', '.join(texts))}</text>"
        )
    for name, y in places.items():
        centre = side + BOX / 2
        kind = fmus[name]["file"].removesuffix(".fmu")
        kind = kind if len(kind) <= 28 else f"{kind[:27]}…"
        yield f'<rect x="{side}" y="{y + 1}" width="{BOX}" height="{HEIGHT}" rx="5"/>'
        yield f'<text x="{centre}" y="{y + 19}" text-anchor="middle">{escape(name)}</text>'
        yield (
            f'<text class="of" x="{centre}" y="{y + 36}" text-anchor="middle">{escape(kind)}</text>'
        )
    yield "</svg></div>"
    yield '<div class="scroll" tabindex="0" role="region" aria-label="Connections"><table>'
    yield '<thead><tr><th scope="col">from</th><th scope="col" class="text">to</th>'
    yield '<th scope="col" class="text">unit</th></tr></thead><tbody>'
    for connection in connections:
        unit = plain_unit(connection["unit"]) or "–"
        yield (
            f"<tr><td>{escape(connection['source'])}</td>"
            f'<td class="text">{escape(connection["target"])}</td>'
            f'<td class="text">{escape(unit)}</td></tr>'
        )
    yield "</tbody></table></div>"
