"""A CasADi expression graph written out as straight-line Python or C.

The text needs nothing but `math`: it is what runs inside an FMU. Nodes that depend on constants
only (parameters, gains) are evaluated once, when the equations are bound to them; a node used
once stands inside the expression that uses it. Both languages do the same operations in the same
order, so that their numbers are equal to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import casadi as ca

__all__ = ["Block", "c_function", "c_functions", "constants_and_functions", "operations"]

_BINARY: dict[int, str] = {
    ca.OP_ADD: "({0} + {1})",
    ca.OP_SUB: "({0} - {1})",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_POW: "{0} ** {1}",
    ca.OP_CONSTPOW: "{0} ** {1}",
    ca.OP_FMIN: "min({0}, {1})",
    ca.OP_FMAX: "max({0}, {1})",
    ca.OP_LT: "float({0} < {1})",
    ca.OP_LE: "float({0} <= {1})",
    ca.OP_EQ: "float({0} == {1})",
    ca.OP_NE: "float({0} != {1})",
    ca.OP_AND: "float({0} != 0.0 and {1} != 0.0)",
    ca.OP_OR: "float({0} != 0.0 or {1} != 0.0)",
    # CasADi's if_else is the sum of two of these: the branch not taken must count as zero even
    # where its value is not finite.
    ca.OP_IF_ELSE_ZERO: "({1} if {0} else 0.0)",
    ca.OP_COPYSIGN: "copysign({0}, {1})",
    ca.OP_ATAN2: "atan2({0}, {1})",
    ca.OP_HYPOT: "hypot({0}, {1})",
}
_UNARY: dict[int, str] = {
    ca.OP_NEG: "-{0}",
    ca.OP_TWICE: "2.0 * {0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_SQRT: "sqrt({0})",
    ca.OP_EXP: "exp({0})",
    ca.OP_LOG: "log({0})",
    ca.OP_SIN: "sin({0})",
    ca.OP_COS: "cos({0})",
    ca.OP_TAN: "tan({0})",
    ca.OP_TANH: "tanh({0})",
    ca.OP_FABS: "abs({0})",
    ca.OP_SIGN: "float(({0} > 0.0) - ({0} < 0.0))",
    ca.OP_NOT: "float({0} == 0.0)",
}
# What C writes in another way than Python; its min and max are those of fmu_src/native/block.h.
_C_BINARY = _BINARY | {
    ca.OP_POW: "pow({0}, {1})",
    ca.OP_CONSTPOW: "pow({0}, {1})",
    ca.OP_FMIN: "lesser({0}, {1})",
    ca.OP_FMAX: "greater({0}, {1})",
    ca.OP_LT: "(double)({0} < {1})",
    ca.OP_LE: "(double)({0} <= {1})",
    ca.OP_EQ: "(double)({0} == {1})",
    ca.OP_NE: "(double)({0} != {1})",
    ca.OP_AND: "(double)({0} != 0.0 && {1} != 0.0)",
    ca.OP_OR: "(double)({0} != 0.0 || {1} != 0.0)",
    ca.OP_IF_ELSE_ZERO: "({0} != 0.0 ? {1} : 0.0)",
}
_C_UNARY = _UNARY | {
    ca.OP_FABS: "fabs({0})",
    ca.OP_SIGN: "sign_of({0})",
    ca.OP_NOT: "(double)({0} == 0.0)",
}
# Operators that bind looser than a call or a name: their text is bracketed inside another one.
_LOOSE = (
    ca.OP_MUL,
    ca.OP_DIV,
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_NEG,
    ca.OP_TWICE,
    ca.OP_SQ,
    ca.OP_INV,
)
# Functions of the C library that take many operations of the processor.
_CALLS = (
    ca.OP_POW,
    ca.OP_CONSTPOW,
    ca.OP_ATAN2,
    ca.OP_HYPOT,
    ca.OP_EXP,
    ca.OP_LOG,
    ca.OP_SIN,
    ca.OP_COS,
    ca.OP_TAN,
    ca.OP_TANH,
)
# Operators whose text repeats an operand: it must then be a name.
_REPEATING = (ca.OP_SQ, ca.OP_SIGN)
# An inlined expression longer than this is given a name, to keep the lines readable.
_LONGEST_INLINE = 72


@dataclass(frozen=True)
class Block:
    """One function to write: its name, its arguments (name, symbol) and its results.

    `arguments` are groups; each group is one Python argument, unpacked where it holds more than
    one symbol.
    """

    name: str
    arguments: tuple[tuple[str, tuple[ca.SX, ...]], ...]
    results: tuple[ca.SX, ...]
    doc: str


@dataclass
class _Node:
    """One operation of the graph in static single assignment form."""

    operation: int
    operands: tuple[int, ...]
    text: str = ""
    fixed: bool = False
    uses: int = 0


def constants_and_functions(
    constants: Sequence[tuple[str, ca.SX]], blocks: Iterable[Block]
) -> list[str]:
    """Source lines of the body of ``bind(constants)``: its fixed nodes, then its functions.

    Parameters
    ----------
    constants : sequence of (name, symbol)
        Symbols known when the equations are bound, under the Python names they then have.
    blocks : iterable of Block
        The functions to write.

    Returns
    -------
    list of str
        Lines without common indentation.

    Raises
    ------
    ValueError
        If a result depends on a symbol that is neither a constant nor an argument.
    """
    fixed_lines: list[str] = []
    function_lines: list[str] = []
    for number, block in enumerate(blocks):
        fixed, function = _Writer(constants, block, prefix=f"f{number}_").write()
        fixed_lines += fixed
        function_lines += ["", *function]
    return fixed_lines + function_lines


def c_functions(
    name: str, constants: Sequence[tuple[str, ca.SX]], blocks: Iterable[Block]
) -> list[str]:
    """C source lines of ``struct name``, which holds the fixed nodes, and of its functions.

    Parameters
    ----------
    name : str
        Of the struct; the functions are ``name_bind`` and ``name_`` with the name of each block.
    constants : sequence of (name, symbol)
        Symbols known when the equations are bound: the elements of its array ``p``.
    blocks : iterable of Block
        The functions to write; each group of arguments is one array.

    Returns
    -------
    list of str
        ``name_bind(p, b)`` evaluates the fixed nodes, ``name_rates(b, x, .., result)`` a block.

    Raises
    ------
    ValueError
        If a result depends on a symbol that is neither a constant nor an argument.
    """
    indexed = [(f"b->p[{i}]", symbol) for i, (_, symbol) in enumerate(constants)]
    fixed_lines: list[str] = []
    function_lines: list[str] = []
    for number, block in enumerate(blocks):
        writer = _Writer(indexed, block, prefix=f"b->f{number}_", c=True)
        fixed, function = writer.write(owner=name)
        fixed_lines += fixed
        function_lines += ["", *function]
    fields = [line.split(" = ")[0].removeprefix("b->") for line in fixed_lines]
    return [
        f"struct {name} {{",
        f"    double p[{max(len(constants), 1)}];",
        *(f"    double {field};" for field in fields),
        "};",
        "",
        f"static void {name}_bind(const double *p, struct {name} *b)",
        "{",
        f"    for (int i = 0; i < {len(constants)}; i++) b->p[i] = p[i];",
        *(f"    {line};" for line in fixed_lines),
        "}",
        *function_lines,
    ]


def c_function(block: Block) -> list[str]:
    """C source lines of a block that depends on its arguments alone: ``name(x, .., result)``."""
    _, function = _Writer((), block, prefix="", c=True).write()
    return function


def operations(block: Block) -> tuple[int, int, int]:
    """What one call of `c_function` costs: sums, products and comparisons; divisions and square
    roots; functions."""
    varying = [n for n in _Writer((), block, "").nodes if not n.fixed and n.operands]
    slow = sum(n.operation in (ca.OP_DIV, ca.OP_INV, ca.OP_SQRT) for n in varying)
    called = sum(n.operation in _CALLS for n in varying)
    return len(varying) - slow - called, slow, called


class _Writer:
    """Writes one block; a current state is held only while it is being written."""

    def __init__(
        self, constants: Sequence[tuple[str, ca.SX]], block: Block, prefix: str, c: bool = False
    ) -> None:
        self._block = block
        self._prefix = prefix
        self._unary, self._binary = (_C_UNARY, _C_BINARY) if c else (_UNARY, _BINARY)
        self._c = c
        self._declaration = "const double " if c else ""
        groups = [
            [f"{name}[{i}]" for i in range(len(symbols))] if c else _names_of(name, symbols)
            for name, symbols in block.arguments
        ]
        self._names = [name for name, _ in constants] + [n for group in groups for n in group]
        self._constant_count = len(constants)
        symbols = [s for _, s in constants] + [s for _, g in block.arguments for s in g]
        results = ca.cse(ca.vertcat(*block.results)) if block.results else ca.SX(0, 1)
        self._function = ca.Function("graph", symbols, [results], {"allow_free": False})
        self._nodes: list[_Node] = []
        self._results: list[int] = [self._constant(0.0)] * len(block.results)
        self._read_graph()

    @property
    def nodes(self) -> Sequence[_Node]:
        """The operations, in the order in which they are done."""
        return self._nodes

    def _constant(self, value: float) -> int:
        return self._append(_Node(ca.OP_CONST, (), repr(float(value)), fixed=True))

    def _read_graph(self) -> None:
        """From CasADi's instructions on a work vector to single assignments."""
        function = self._function
        at: dict[int, int] = {}
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            inputs, outputs = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_OUTPUT:
                self._results[outputs[1]] = at[inputs[0]]
                self._nodes[at[inputs[0]]].uses += 1
            elif operation == ca.OP_CONST:
                at[outputs[0]] = self._constant(function.instruction_constant(k))
            elif operation == ca.OP_INPUT:
                position = inputs[0]
                at[outputs[0]] = self._append(
                    _Node(operation, (), self._names[position], position < self._constant_count)
                )
            else:
                operands = tuple(at[i] for i in inputs)
                for i in operands:
                    self._nodes[i].uses += 1
                fixed = all(self._nodes[i].fixed for i in operands)
                at[outputs[0]] = self._append(_Node(operation, operands, fixed=fixed))

    def _append(self, node: _Node) -> int:
        self._nodes.append(node)
        return len(self._nodes) - 1

    def write(self, owner: str | None = None) -> tuple[list[str], list[str]]:
        """The lines to evaluate once, and those of the function; in C, `owner` is the struct of
        the former, if there is one."""
        needed_by_function = self._fixed_nodes_needed()
        repeated = {i for n in self._nodes if n.operation in _REPEATING for i in n.operands}
        fixed_lines: list[str] = []
        body: list[str] = []
        for index, node in enumerate(self._nodes):
            if node.operation in (ca.OP_CONST, ca.OP_INPUT):
                continue
            text = self._expression(node)
            named = (
                node.uses > 1
                or index in needed_by_function
                or len(text) > _LONGEST_INLINE
                or index in repeated
            )
            if named:
                name = f"{self._prefix}{index}" if node.fixed else f"w{index}"
                declared = name if node.fixed else self._declaration + name
                (fixed_lines if node.fixed else body).append(f"{declared} = {_unbracketed(text)}")
                node.text, node.operation = name, ca.OP_INPUT
            else:
                node.text = text
        if self._c:
            return fixed_lines, self._c_function(owner, body)
        returned = ", ".join(_unbracketed(self._nodes[i].text) for i in self._results)
        comma = "," if len(self._results) == 1 else ""
        return fixed_lines, [
            f"def {self._block.name}({', '.join(name for name, _ in self._block.arguments)}):",
            f'    """{self._block.doc}"""',
            *(f"    {line}" for line in self._unpacking()),
            *(f"    {line}" for line in body),
            f"    return ({returned}{comma})",
        ]

    def _c_function(self, owner: str | None, body: list[str]) -> list[str]:
        arrays = [name for name, _ in self._block.arguments]
        arguments = [f"const double *{name}" for name in arrays]
        name = self._block.name
        if owner is not None:
            arrays, name = ["b", *arrays], f"{owner}_{name}"
            arguments = [f"const struct {owner} *b", *arguments]
        unused = ", ".join(f"(void){array}" for array in (*arrays, "result"))
        texts = [_unbracketed(self._nodes[i].text) for i in self._results]
        return [
            f"/* {self._block.doc} */",
            f"static void {name}({', '.join((*arguments, 'double *result'))})",
            "{",
            f"    {unused};",
            *(f"    {line};" for line in body),
            *(f"    result[{i}] = {text};" for i, text in enumerate(texts)),
            "}",
        ]

    def _unpacking(self) -> list[str]:
        lines = []
        for name, symbols in self._block.arguments:
            names = _names_of(name, symbols)
            if names:
                lines.append(f"({', '.join(names)},) = {name}")
        return lines

    def _fixed_nodes_needed(self) -> set[int]:
        """Fixed nodes that a varying node or the return statement uses."""
        needed = {i for n in self._nodes if not n.fixed for i in n.operands if self._nodes[i].fixed}
        return needed | {i for i in self._results if self._nodes[i].fixed}

    def _expression(self, node: _Node) -> str:
        operands = [self._operand(self._nodes[i]) for i in node.operands]
        table = self._unary if len(operands) == 1 else self._binary
        try:
            return table[node.operation].format(*operands)
        except KeyError:
            raise ValueError(
                f"operation {node.operation} of the expression graph has no Python form; "
                "see the tables in congelation.export.straight_line"
            ) from None

    def _operand(self, node: _Node) -> str:
        loose = node.operation in _LOOSE or (
            node.operation == ca.OP_CONST and node.text.startswith("-")
        )
        return f"({node.text})" if loose else node.text


def _names_of(name: str, symbols: Sequence[ca.SX]) -> list[str]:
    return [f"{name}{i + 1}" for i in range(len(symbols))]


def _unbracketed(text: str) -> str:
    """Without the outer brackets that a sum is written with."""
    if not (text.startswith("(") and text.endswith(")")):
        return text
    depth = 0
    for position, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0 and position < len(text) - 1:
            return text
    return text[1:-1]
