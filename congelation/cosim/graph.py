"""Order of evaluation: which connected values follow from which, and where they form loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

__all__ = ["strong_components"]


def strong_components(successors: Mapping[int, Sequence[int]]) -> list[list[int]]:
    """Strongly connected components of a directed graph, in topological order.

    R. Tarjan, Depth-first search and linear graph algorithms, SIAM J. Computing 1 (1972), without
    recursion.

    Parameters
    ----------
    successors : mapping of int to sequence of int
        Every node is a key.

    Returns
    -------
    list of list of int
        A component comes before those that its edges lead to.
    """
    number: dict[int, int] = {}
    low: dict[int, int] = {}
    stack: list[int] = []
    found: list[list[int]] = []
    for root in successors:
        if root in number:
            continue
        path = [(root, iter(successors[root]))]
        number[root] = low[root] = len(number)
        stack.append(root)
        while path:
            node, rest = path[-1]
            step = next(rest, None)
            if step is None:
                path.pop()
                if path:
                    low[path[-1][0]] = min(low[path[-1][0]], low[node])
                if low[node] == number[node]:
                    found.append(_popped(stack, node))
                    for member in found[-1]:
                        low[member] = len(successors)
            elif step not in number:
                number[step] = low[step] = len(number)
                stack.append(step)
                path.append((step, iter(successors[step])))
            else:
                # A node of a finished component has the low of no open one.
                low[node] = min(
                    low[node], low[step] if low[step] == len(successors) else number[step]
                )
    return found[::-1]


def _popped(stack: list[int], node: int) -> list[int]:
    place = stack.index(node)
    component = stack[place:]
    del stack[place:]
    return component
