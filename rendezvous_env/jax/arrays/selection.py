"""Kernels that branch on numbers, rewritten to select between arrays.

A kernel is a function of numbers, with ``if``, early returns and loops of known length. Its source
is rewritten so that each branch is a function, and both are computed where the condition is an
array:

    if x > 0.0:                 def then(): return a
        return a         →      def otherwise(): return b
    return b                    return choose(x > 0.0, then, otherwise)

A condition on lengths of tuples or other constants is decided as Python does. Returns, ``break``
and ``continue`` within loops are not supported.
"""

import ast
import inspect
import textwrap
from types import CodeType, FunctionType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

_UNSUPPORTED = (ast.While, ast.Break, ast.Continue, ast.Try, ast.With)
_NUMBERS = (bool, int, float, np.generic)


def is_static(*values: Any) -> bool:
    """True if all values are numbers rather than arrays."""
    return all(isinstance(value, _NUMBERS) for value in values)


def choose(condition: Any, then: Any, otherwise: Any) -> Any:
    """Result of one of two functions; of both, selected entry by entry, for an array."""
    if is_static(condition):
        return then() if condition else otherwise()
    results = then(), otherwise()
    if all(result is None for result in results):
        raise NotImplementedError("a branch on arrays has to return or assign something")
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), *results)


def both(a: Any, b: Any) -> Any:
    """``a and b()``."""
    if is_static(a):
        return b() if a else a
    return jnp.logical_and(a, b())


def either(a: Any, b: Any) -> Any:
    """``a or b()``."""
    if is_static(a):
        return a or b()
    return jnp.logical_or(a, b())


def negated(a: Any) -> Any:
    """``not a``."""
    return not a if is_static(a) else jnp.logical_not(a)


def divided(a: Any, b: Any) -> Any:
    """Quotient a/b, and 0 with a derivative of 0 where b is 0.

    Kernels divide by zero only in branches that are not taken. There a finite number keeps
    gradients finite.
    """
    if is_static(b):
        return a / b
    some = b != 0.0
    return jnp.where(some, a / jnp.where(some, b, jnp.ones_like(b)), jnp.zeros_like(a))


HELPERS = {f"{helper.__name__}__": helper for helper in (choose, both, either, negated, divided)}
"""Names of the functions that rewritten code calls."""


def rewritten(function: FunctionType) -> tuple[CodeType, set[str]]:
    """Code that defines the selecting form of a function, and the globals that it reads.

    Raises:
        NotImplementedError: for a statement that is not supported.
    """
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    (node,) = tree.body
    assert isinstance(node, ast.FunctionDef)
    _check(node)
    node.decorator_list, node.returns = [], None
    arguments = {one.arg for one in (*node.args.args, *node.args.kwonlyargs)}
    arguments |= {one.arg for one in (node.args.vararg, node.args.kwarg) if one is not None}
    node.body = _Branches().block(node.body, arguments)
    own = arguments | _assigned([node])
    tree = ast.fix_missing_locations(_Expressions().visit(tree))
    names = {one.id for one in ast.walk(tree) if isinstance(one, ast.Name)} - own
    return compile(tree, f"<array form of {node.name}>", "exec"), names


def _check(node: ast.FunctionDef) -> None:
    for one in (x for x in ast.walk(node) if isinstance(x, ast.stmt)):
        returns = isinstance(one, ast.For) and any(isinstance(x, ast.Return) for x in ast.walk(one))
        if returns or isinstance(one, _UNSUPPORTED):
            raise NotImplementedError(
                f"{node.name} has no array form: {type(one).__name__} in line {one.lineno}; "
                "register one with replaces"
            )


class _Branches:
    """Rewrites the ``if`` statements of a function."""

    def __init__(self) -> None:
        self._count = 0

    def block(self, statements: list[ast.stmt], bound: set[str]) -> list[ast.stmt]:
        """Rewritten statements, given the names that have a value before them."""
        bound, out = set(bound), list[ast.stmt]()
        for k, statement in enumerate(statements):
            if isinstance(statement, ast.If):
                if _returns(statement.body) or _returns(statement.orelse):
                    return out + self._last(statement, statements[k + 1 :], bound)
                out += self._assigning(statement, bound)
            else:
                if isinstance(statement, ast.For):
                    inside = bound | _assigned([statement.target])
                    statement.body = self.block(statement.body, inside)
                out.append(statement)
            bound |= _assigned([statement])
        return out

    def _last(self, node: ast.If, rest: list[ast.stmt], bound: set[str]) -> list[ast.stmt]:
        """An ``if`` with a return: the rest of the function belongs to the other branch."""
        branches = [body if _returns(body) else body + rest for body in (node.body, node.orelse)]
        defined, chosen = self._chosen(node.test, branches, bound)
        return [*defined, ast.Return(chosen)]

    def _assigning(self, node: ast.If, bound: set[str]) -> list[ast.stmt]:
        """An ``if`` that assigns names."""
        one, other = _assigned(node.body), _assigned(node.orelse)
        names = sorted((one | other) & (bound | (one & other)))
        if not names:  # calls; ``choose`` raises for a condition of arrays
            defined, chosen = self._chosen(node.test, [node.body, node.orelse], bound)
            return [*defined, ast.Expr(chosen)]
        values = ast.Tuple([ast.Name(name, ast.Load()) for name in names], ast.Load())
        branches = [[*body, ast.Return(values)] for body in (node.body, node.orelse)]
        defined, chosen = self._chosen(node.test, branches, bound)
        targets = ast.Tuple([ast.Name(name, ast.Store()) for name in names], ast.Store())
        return [*defined, ast.Assign([targets], chosen)]

    def _chosen(
        self, test: ast.expr, branches: list[list[ast.stmt]], bound: set[str]
    ) -> tuple[list[ast.stmt], ast.expr]:
        """Two functions, and the call that chooses between them."""
        self._count += 1
        names = [f"then_{self._count}__", f"otherwise_{self._count}__"]
        defined: list[ast.stmt] = []
        for name, body in zip(names, branches, strict=True):
            # what a branch assigns is its own; its value before is passed as a default
            own = sorted(_assigned(body) & bound)
            given = ast.arguments(
                posonlyargs=[],
                args=[ast.arg(one) for one in own],
                kwonlyargs=[],
                kw_defaults=[],
                defaults=[ast.Name(one, ast.Load()) for one in own],
            )
            code: Any = self.block(body, bound) or [ast.Pass()]
            made: Any = ast.FunctionDef(name, given, code, [])
            made.type_params = []  # which Python 3.12 and later need
            defined.append(made)
        functions = [ast.Name(name, ast.Load()) for name in names]
        return defined, _call("choose__", test, *functions)


def _returns(body: list[ast.stmt]) -> bool:
    if not body:
        return False
    last = body[-1]
    if isinstance(last, ast.If):
        return _returns(last.body) and _returns(last.orelse)
    return isinstance(last, ast.Return)


def _assigned(nodes: Any) -> set[str]:
    return {
        one.id
        for node in nodes
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }


def _call(name: str, *arguments: Any) -> ast.Call:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _later(value: ast.expr) -> ast.Lambda:
    nothing = ast.arguments(posonlyargs=[], args=[], kwonlyargs=[], kw_defaults=[], defaults=[])
    return ast.Lambda(nothing, value)


class _Expressions(ast.NodeTransformer):
    """Rewrites expressions whose operands may be arrays."""

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        self.generic_visit(node)
        return _call("choose__", node.test, _later(node.body), _later(node.orelse))

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        self.generic_visit(node)
        name = "both__" if isinstance(node.op, ast.And) else "either__"
        *earlier, result = node.values
        for value in reversed(earlier):
            result = _call(name, value, _later(result))
        return result

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        self.generic_visit(node)
        return _call("negated__", node.operand) if isinstance(node.op, ast.Not) else node

    def visit_BinOp(self, node: ast.BinOp) -> Any:
        self.generic_visit(node)
        return _call("divided__", node.left, node.right) if isinstance(node.op, ast.Div) else node

    def visit_Compare(self, node: ast.Compare) -> Any:
        self.generic_visit(node)
        if len(node.ops) == 1:
            return node
        sides = [node.left, *node.comparators]
        pairs: list[ast.expr] = [
            ast.Compare(a, [op], [b]) for a, op, b in zip(sides, node.ops, sides[1:], strict=False)
        ]
        *earlier, result = pairs
        for value in reversed(earlier):
            result = _call("both__", value, _later(result))
        return result
