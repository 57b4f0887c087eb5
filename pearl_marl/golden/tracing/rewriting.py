"""An author's function as Python to be traced: every decision on a word becomes a call of a :class:`Frame`.

Python decides by values, and a word has none before hardware runs. So a function is compiled once more from
its source, in which an ``if`` runs both its sides and joins what they leave behind, a loop joins what its
rounds leave, and ``return``, ``break`` and ``continue`` note under which condition they were reached. Each
statement stands there once, so what is traced grows with the length of the function, not with its number of
paths.

Lines stay the author's. :mod:`pearl_marl.golden.tracing.runtime` is what the calls do.
"""

from __future__ import annotations
import __future__

import ast
import builtins
import functools
import inspect
import linecache
import pickle
import textwrap
import threading
import types
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NoReturn, TypeVar

from pearl_marl.base.source_lines import source_line
from pearl_marl.errors import ArgumentError

RUNTIME = "__pearl__"
"""The name by which rewritten functions know :class:`pearl_marl.golden.tracing.runtime.Runtime`."""
_FRAME = "_pearl_frame"

_Node = TypeVar("_Node", bound=ast.AST)

# CPython 3.11 counts how deep the trees of all threads are in one number, and parts of a batch are opened by
# several threads: "AST constructor recursion depth mismatch", where the garbage collector ran in between.
_ONE_AT_A_TIME = threading.RLock()


class Refusal(ArgumentError):  # noqa: N818 - no error of its own, but one that is said already
    """What names its line already."""


@functools.lru_cache(1 << 12)
def rewritten(code: types.CodeType) -> types.CodeType:
    """Return the code of a function whose decisions are calls; its own where no source is at hand.

    Raises
    ------
    ArgumentError
        The function does what cannot be traced, such as ``yield``, or its file says something else by now;
        names the file and the line.
    """
    if code.co_flags & (inspect.CO_COROUTINE | inspect.CO_ASYNC_GENERATOR):
        where = source_line(code.co_filename, code.co_firstlineno)
        raise Refusal(f"{where}: golden functions have no `async`")
    with _ONE_AT_A_TIME:
        return _rewritten(code)


def _rewritten(code: types.CodeType) -> types.CodeType:
    found = pickle.loads(pickle.dumps(_source_of(code)))  # a copy, in a fifth of the time of deepcopy()
    if found is None:
        return code
    if isinstance(found, ast.Lambda):
        found = _named(found)
    elif _has_changed(found, code):
        raise Refusal(
            f"{source_line(code.co_filename, code.co_firstlineno)}: {code.co_name}() is not what its file "
            "says; the file has changed since it was imported: start Python anew"
        )
    new = _Function(code.co_filename).of(found)
    return _compiled(new, code)


def _has_changed(node: ast.FunctionDef, code: types.CodeType) -> bool:
    """Return whether a definition is not what code was compiled from."""
    # A test's `assert` is another statement where pytest runs it.
    if any(isinstance(inner, ast.Assert) for inner in ast.walk(node)):
        return False
    file, flags = code.co_filename, code.co_flags & __future__.annotations.compiler_flag
    found = _codes(file, _text(file), flags).get((code.co_qualname, code.co_firstlineno))
    return found is not None and not _same(found, code)


def _same(one: Any, other: Any) -> bool:
    """Return whether two functions run the same instructions on the same constants."""
    if not isinstance(one, types.CodeType) or not isinstance(other, types.CodeType):
        return type(one) is type(other) and bool(one == other)
    if one.co_code != other.co_code or one.co_names != other.co_names:
        return False
    return len(one.co_consts) == len(other.co_consts) and all(map(_same, one.co_consts, other.co_consts))


def _text(file: str) -> str:
    return "".join(linecache.getlines(file))


@functools.cache
def _codes(file: str, text: str, flags: int) -> dict[tuple[str, int], types.CodeType]:
    """Return all functions that a file of this text makes, by their qualified names and lines."""
    found: dict[tuple[str, int], types.CodeType] = {}
    left: list[Any] = [compile(text, file, "exec", flags, dont_inherit=True)]
    while left:
        code = left.pop()
        found[code.co_qualname, code.co_firstlineno] = code
        left += (constant for constant in code.co_consts if isinstance(constant, types.CodeType))
    return found


def _source_of(code: types.CodeType) -> ast.FunctionDef | ast.Lambda | None:
    """Return the definition that code was compiled from."""
    found = [node for node in _definitions(_text(code.co_filename)) if _matches(node, code)]
    return found[0] if len(found) == 1 else None


def _matches(node: ast.FunctionDef | ast.Lambda, code: types.CodeType) -> bool:
    if isinstance(node, ast.Lambda):
        if code.co_name != "<lambda>" or node.lineno != code.co_firstlineno:
            return False
        # Several in one line are told apart by where their bodies stand.
        places = {(line, column) for line, _, column, _ in code.co_positions()}
        return (node.body.lineno, node.body.col_offset) in places
    first = min((node.lineno, *(d.lineno for d in node.decorator_list)))
    return node.name == code.co_name and first == code.co_firstlineno


@functools.cache
def _definitions(text: str) -> list[ast.FunctionDef | ast.Lambda]:
    """Return all functions that a text defines; none where it cannot be read."""
    try:
        tree = ast.parse(text)
    except SyntaxError:
        return []
    return [node for node in ast.walk(tree) if isinstance(node, (ast.FunctionDef, ast.Lambda))]


def _named(node: ast.Lambda) -> ast.FunctionDef:
    """Return a lambda as a function of a statement."""
    body = ast.copy_location(ast.Return(node.body), node.body)
    return ast.copy_location(ast.FunctionDef("_lambda", node.args, [body], [], None, None), node)


def _compiled(node: ast.FunctionDef, code: types.CodeType) -> types.CodeType:
    """Compile a function whose free names are those of ``code``."""
    # A function around it has its free names, so that they are free here, too.
    outer = ast.parse("def _outer(): return 0").body[0]
    assert isinstance(outer, ast.FunctionDef)
    outer.args.args = [ast.arg(name) for name in code.co_freevars]
    outer.body = [node, *outer.body]
    # By its own name it would be a variable there, and what calls itself names itself as its module does.
    node.name, node.decorator_list = "_pearl_function", []
    module = ast.fix_missing_locations(ast.Module([outer], []))
    whole = compile(module, code.co_filename, "exec", dont_inherit=True)
    inner = _constants(_constants(whole, "_outer"), node.name)
    return inner.replace(co_name=code.co_name, co_qualname=code.co_qualname)


def _constants(code: types.CodeType, name: str) -> types.CodeType:
    return next(c for c in code.co_consts if isinstance(c, types.CodeType) and c.co_name == name)


def _stored(nodes: Sequence[ast.AST]) -> list[str]:
    """Return the names that statements bind, in order, and not those that functions inside them do."""
    names: dict[str, None] = {}

    def visit(node: ast.AST) -> None:
        match node:
            case ast.FunctionDef() | ast.ClassDef() | ast.AsyncFunctionDef():
                names[node.name] = None
                for inner in ast.walk(node):
                    if isinstance(inner, ast.Nonlocal):
                        names.update(dict.fromkeys(inner.names))
                return
            case ast.Lambda():
                return
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                # Only `:=` inside binds a name of the function.
                for inner in ast.walk(node):
                    if isinstance(inner, ast.NamedExpr):
                        names[inner.target.id] = None
                return
            case ast.Name(ctx=ast.Store()):
                names[node.id] = None
        for child in ast.iter_child_nodes(node):
            visit(child)

    for node in nodes:
        visit(node)
    return list(names)


def _inside(nodes: Sequence[ast.AST]) -> Iterator[ast.AST]:
    """Yield statements and those inside them, without those of functions."""
    for node in nodes:
        yield node
        if not isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            yield from _inside([*getattr(node, "body", ()), *getattr(node, "orelse", ())])


def _leaves(nodes: Sequence[ast.AST]) -> bool:
    """Return whether statements may leave what is around them: by a return, a break or a continue."""
    return any(isinstance(node, (ast.Return, ast.Break, ast.Continue)) for node in _inside(nodes))


class _Function(ast.NodeTransformer):
    """Rewrites one function: its statements, and in expressions what Python decides by a value."""

    def __init__(self, file: str) -> None:
        self.file, self.count, self.loops = file, 0, list[tuple[str, str]]()
        self.unbound: list[str] = []
        """Variables that some path may leave without a value."""

    def of(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Return the function with its decisions as calls."""
        body = node.body
        joined = [s for s in _inside(body) if isinstance(s, (ast.If, ast.For, ast.While))]
        own = {a.arg for a in _arguments(node.args)}
        elsewhere = {n for s in _inside(body) if isinstance(s, (ast.Nonlocal, ast.Global)) for n in s.names}
        self.unbound = [n for n in _stored(joined) if n not in own | elsewhere]
        for argument in _arguments(node.args):
            argument.annotation = None  # for readers, and may name what is known to a type checker only
        begin = [f"{_FRAME} = {RUNTIME}.frame()", *(f"{n} = {RUNTIME}.unbound({n!r})" for n in self.unbound)]
        end = _filled(f"return {_FRAME}.result()", body[-1])
        node.args, node.returns = self.visit(node.args), None
        node.body = [*_filled("\n".join(begin), node), *self.block(body), *end]
        node.type_params = []  # type: ignore[attr-defined]
        return node

    def name(self, kind: str) -> str:
        """Return a new name."""
        self.count += 1
        return f"_pearl_{kind}_{self.count}"

    def refuse(self, node: ast.AST, why: str) -> NoReturn:
        """Raise ArgumentError for a line."""
        raise Refusal(f"{source_line(self.file, getattr(node, 'lineno', 1))}: {why}")

    def block(self, statements: Sequence[ast.stmt]) -> list[ast.stmt]:
        """Return statements of which those after a possible exit run only if something is left to run."""
        result: list[ast.stmt] = []
        for k, statement in enumerate(statements):
            result += self.statement(statement)
            if isinstance(statement, (ast.Return, ast.Break, ast.Continue)):
                break
            rest = statements[k + 1 :]
            if rest and isinstance(statement, (ast.If, ast.For, ast.While)) and _leaves([statement]):
                return [*result, *_filled(_IF_ALIVE, statement, rest=self.block(rest))]
        return result

    def statement(self, node: ast.stmt) -> list[ast.stmt]:
        """Return the statements that take the place of one."""
        match node:
            case ast.Return():
                value = self.visit(node.value or ast.Constant(None))
                return _filled(f"{_FRAME}.returns(_.value)", node, value=value)
            case ast.If():
                return self.branch(node)
            case ast.While() | ast.For():
                return self.loop(node)
            case ast.Break() | ast.Continue():
                loop, names = self.loops[-1]
                verb = "breaks" if isinstance(node, ast.Break) else "continues"
                return _filled(f"{loop}.{verb}({names})", node)
            case ast.Assign() if any(map(_has_parts, node.targets)):
                return self.stores(node)
            case ast.AugAssign(target=ast.Subscript() | ast.Attribute()):
                return self.changes(node)
            case ast.AugAssign(target=ast.Name(id=name)):
                # In place, a list would grow.
                return [*_filled(f"{RUNTIME}.growing({name})", node), self.visit(node)]
            case ast.Delete():
                return self.removal(node)
            case ast.AnnAssign():
                if node.value is None:
                    return _filled("pass", node)
                plain = ast.copy_location(ast.Assign([node.target], node.value), node)
                return self.statement(plain)
            case ast.Assert():
                return _filled(f"{RUNTIME}.asserts(_.test)", node, test=self.visit(node.test))
            case ast.Raise():
                return [*_filled(f"{RUNTIME}.raises()", node), self.visit(node)]
            case ast.Nonlocal() | ast.Global():
                self.refuse(
                    node, f"`{node.names[0]}` of a function around it is assigned to; return it instead"
                )
            case ast.Import() | ast.ImportFrom():
                self.refuse(node, "golden functions have no `import`; import where the file begins")
            case ast.Match():
                self.refuse(node, "golden functions have no `match`; use `if`, `elif` and `else`")
            case ast.Try() | ast.With() | ast.AsyncFor() | ast.AsyncWith() | ast.AsyncFunctionDef():
                word = (
                    type(node).__name__.lower().removeprefix("async").removesuffix("functiondef") or "async"
                )
                self.refuse(node, f"golden functions have no `{word}`")
        return [self.visit(node)]

    def removal(self, node: ast.Delete) -> list[ast.stmt]:
        """Return the removal of elements, of lists that may become shorter."""
        result = []
        for target in node.targets:
            if not isinstance(target, ast.Subscript):
                self.refuse(node, "golden functions have no `del` of variables")
            result += _filled(f"{RUNTIME}.growing(_.list)", node, list=self.visit(target.value))
        return [*result, self.visit(node)]

    def branch(self, node: ast.If) -> list[ast.stmt]:
        """Return an ``if``: each side runs if it may be taken, and then they are joined."""
        fork, names = self.name("fork"), _tuple(_stored([*node.body, *node.orelse]))
        text = f"""
            {fork} = {_FRAME}.fork(_.test, {names})
            if {fork}.takes(0):
                _.body
                {fork}.leaves({names})
            if {fork}.takes(1):
                {names} = {fork}.before
                _.orelse
                {fork}.leaves({names})
            {names} = {fork}.joined()
        """
        test, body, orelse = self.visit(node.test), self.block(node.body), self.block(node.orelse)
        return _filled(text, node, test=test, body=body, orelse=orelse)

    def loop(self, node: ast.For | ast.While) -> list[ast.stmt]:
        """Return a ``for``, or a ``while``, which goes round until no word can want it."""
        loop, names = self.name("loop"), _tuple(_stored([node]))
        holes: dict[str, Any] = {"alive": []}
        if isinstance(node, ast.While):
            # A round may leave no path on which there is a test.
            head = f"while {_FRAME}.lives() and {loop}.again(_.test, {names})"
            holes["test"] = self.visit(node.test)
        else:
            if _has_parts(node.target):
                self.refuse(
                    node, "a `for` counts in an element or an attribute; count in a variable, and assign it"
                )
            head = f"for _.target in {RUNTIME}.items(_.values)"
            holes |= {"values": self.visit(node.iter), "target": self.visit(node.target)}
            if _leaves(node.body):
                holes["alive"] = _filled(f"if not {_FRAME}.lives(): break", node)
        self.loops.append((loop, names))
        holes["body"] = self.block(node.body)
        self.loops.pop()
        # Only `continue` leaves something to join.
        if any(isinstance(inner, ast.Continue) for inner in _inside(node.body)):
            holes["body"] += _filled(f"{names} = {loop}.next_round({names})", node)
        if node.orelse:
            finished = f"{names} = {loop}.finished({names})\n{_IF_ALIVE}"
            holes["orelse"] = _filled(finished, node, rest=self.block(node.orelse))
        text = f"""
            {loop} = {_FRAME}.loop()
            {head}:
                _.alive
                _.body
            {"_.orelse" if node.orelse else ""}
            {names} = {loop}.joined({names})
        """
        return _filled(text, node, **holes)

    def stores(self, node: ast.Assign) -> list[ast.stmt]:
        """Return assignments to elements and attributes as calls."""
        value = self.name("value")
        result = _filled(f"{value} = _.value", node, value=self.visit(node.value))
        for target in node.targets:
            result += self.store(target, value)
        return result

    def store(self, target: ast.expr, value: str) -> list[ast.stmt]:
        """Return the assignment of a variable."""
        match target:
            case ast.Subscript():
                of, key = self.visit(target.value), self.visit(target.slice)
                return _filled(f"{RUNTIME}.put(_.of, _.key, {value})", target, of=of, key=key)
            case ast.Attribute():
                text = f"{RUNTIME}.set_attribute(_.of, {target.attr!r}, {value})"
                return _filled(text, target, of=self.visit(target.value))
            case ast.Tuple() | ast.List() if _has_parts(target):
                names = [self.name("part") for _ in target.elts]
                result = _filled(f"{_tuple(names)} = {value}", target)
                for part, name in zip(target.elts, names, strict=True):
                    if isinstance(part, ast.Starred):
                        self.refuse(part, "`*` beside elements; assign the parts one by one")
                    result += self.store(part, name)
                return result
        return _filled(f"_.target = {value}", target, target=target)

    def changes(self, node: ast.AugAssign) -> list[ast.stmt]:
        """Return ``a[k] += b``, in which ``a`` and ``k`` are evaluated once."""
        target, of, key, old = node.target, self.name("of"), self.name("key"), self.name("old")
        assert isinstance(target, (ast.Subscript, ast.Attribute))
        if isinstance(target, ast.Subscript):
            getter, setter, place = f"{RUNTIME}.item", "put", self.visit(target.slice)
        else:
            getter, setter, place = "getattr", "set_attribute", ast.Constant(target.attr)
        # By a name of its own, so that a list grows in place.
        changed = ast.AugAssign(ast.Name(old, ast.Store()), node.op, self.visit(node.value))
        text = f"""
            {of} = _.of
            {key} = _.place
            {old} = {getter}({of}, {key})
            {RUNTIME}.growing({old})
            _.changed
            {RUNTIME}.{setter}({of}, {key}, {old})
        """
        whole = self.visit(target.value)
        return _filled(text, node, of=whole, place=place, changed=[ast.copy_location(changed, node)])

    def visit(self, node: ast.AST) -> Any:
        """Return what takes the place of an expression."""
        match node:
            case ast.BoolOp():
                return self.bool_op(node)
            case ast.UnaryOp(op=ast.Not()):
                return _expression(f"{RUNTIME}.negation", [self.visit(node.operand)], node)
            case ast.IfExp():
                sides = [self.later(self.visit(node.body)), self.later(self.visit(node.orelse))]
                return _expression(f"{RUNTIME}.either", [self.visit(node.test), *sides], node)
            case ast.Compare():
                return self.comparison(node)
            case ast.Subscript(ctx=ast.Load()):
                return _expression(f"{RUNTIME}.item", [self.visit(node.value), self.visit(node.slice)], node)
            case ast.List(ctx=ast.Load()) | ast.ListComp():
                self.generic_visit(node)
                return _expression(f"{RUNTIME}.listed", [node], node)
            case ast.Call():
                return self.call(node)
            case ast.FunctionDef():
                node.decorator_list = list(map(self.visit, node.decorator_list))
                return _Function(self.file).of(node)
            case ast.comprehension():
                node.ifs = [_expression(f"{RUNTIME}.keeps", [test], test) for test in node.ifs]
            case ast.Yield() | ast.YieldFrom() | ast.Await():
                self.refuse(node, "golden functions are no generators; return a list")
        return self.generic_visit(node)

    def bool_op(self, node: ast.BoolOp) -> Any:
        """Let the later operands wait, as Python does."""
        values: list[ast.expr] = [self.visit(v) for v in node.values]
        verb = "both" if isinstance(node.op, ast.And) else "any_of_two"
        result = values[0]
        for value in values[1:]:
            result = _expression(f"{RUNTIME}.{verb}", [result, self.later(value)], node)
        return result

    def comparison(self, node: ast.Compare) -> Any:
        """Return chains as calls, and what compares sequences."""
        values = [self.visit(v) for v in (node.left, *node.comparators)]
        names = [_COMPARISONS[type(op).__name__] for op in node.ops]
        if len(names) == 1:
            return _expression(f"{RUNTIME}.{names[0]}", values, node)
        each = ast.Tuple([ast.Constant(name) for name in names], ast.Load())
        result = [each, values[0], *map(self.later, values[1:])]
        return _expression(f"{RUNTIME}.chain", result, node)

    def call(self, node: ast.Call) -> Any:
        """Count what fits, in place of leaving out what does not: that is no word's to decide."""
        if isinstance(node.func, ast.Name) and node.func.id in _REDUCTIONS and node.args:
            inner = node.args[0]
            if isinstance(inner, (ast.GeneratorExp, ast.ListComp)):
                node = _unfiltered(node, inner)
        if isinstance(node.func, ast.Attribute):
            of, verb = self.visit(node.func.value), node.func.attr
            if verb in ("index", "count") and len(node.args) == 1 and not node.keywords:
                return _expression(f"{RUNTIME}.{verb}", [of, self.visit(node.args[0])], node)
            if verb in _GROWING:
                of = _expression(f"{RUNTIME}.growing", [of, ast.Constant(verb)], node)
            node.func.value, function = of, node.func
        else:
            function = self.visit(node.func)
        if isinstance(node.func, ast.Name) and node.func.id == "type" and len(node.args) == 1:
            return _expression(f"{RUNTIME}.type_of", [self.visit(node.args[0])], node)
        is_next = isinstance(node.func, ast.Name) and node.func.id == "next" and node.args
        if is_next and not isinstance(node.args[0], ast.GeneratorExp):
            node.args[0] = _expression(f"{RUNTIME}.advancing", [node.args[0]], node)
        # Python's own functions stay: `super()` finds its class by its name.
        is_pythons = isinstance(node.func, ast.Name) and hasattr(builtins, node.func.id)
        node.func = function if is_pythons else _expression(f"{RUNTIME}.called", [function], node)
        node.args = list(map(self.argument, node.args))
        for keyword in node.keywords:
            keyword.value = self.argument(keyword.value)
        return node

    def argument(self, node: ast.expr) -> Any:
        """Return an argument of a call; a variable has to have a value where the call is."""
        if isinstance(node, ast.Name) and node.id in self.unbound:
            return _expression(f"{RUNTIME}.defined", [node], node)
        return self.visit(node)

    def later(self, node: ast.expr) -> ast.expr:
        """Return a function of no arguments that evaluates an expression."""
        for inner in ast.walk(node):
            if isinstance(inner, ast.NamedExpr):
                self.refuse(
                    inner, f"`{inner.target.id} :=` in what is not always evaluated; assign it before"
                )
        new = _placed(ast.parse("lambda: 0", mode="eval").body, node)
        assert isinstance(new, ast.Lambda)
        new.body = node
        return new


_IF_ALIVE = f"if {_FRAME}.lives():\n    _.rest"
_REDUCTIONS = "any", "all", "sum"
_GROWING = {
    *("append", "extend", "insert", "pop", "remove", "clear", "sort", "reverse"),
    *("add", "discard", "update", "setdefault", "popitem"),
    *("difference_update", "intersection_update", "symmetric_difference_update"),
    *("appendleft", "extendleft", "popleft", "rotate"),
}
"""The methods that change a list, a dict, a set or a deque."""
_COMPARISONS = {
    "Eq": "equal",
    "NotEq": "differ",
    "In": "contains",
    "NotIn": "lacks",
    "Is": "same",
    "IsNot": "other",
    "Lt": "less",
    "LtE": "less_equal",
    "Gt": "greater",
    "GtE": "greater_equal",
}


def _unfiltered(call: ast.Call, inner: ast.GeneratorExp | ast.ListComp) -> ast.Call:
    """Return ``any(x for ... if c)`` as ``any(c and x for ...)``, ``all`` and ``sum`` likewise.

    What comes after an ``if`` is inside it, a second ``for``, too: there it is a reduction of its own.
    """
    if not any(generator.ifs for generator in inner.generators):
        return call
    name, element, result = call.func.id, inner.elt, call  # type: ignore[attr-defined]
    for generator in reversed(inner.generators):
        for test in reversed(generator.ifs):
            match name:
                case "any":
                    element = ast.copy_location(ast.BoolOp(ast.And(), [test, element]), element)
                case "all":
                    refused = ast.copy_location(ast.UnaryOp(ast.Not(), test), test)
                    element = ast.copy_location(ast.BoolOp(ast.Or(), [refused, element]), element)
                case _:
                    nothing = ast.copy_location(ast.Constant(0), element)
                    element = ast.copy_location(ast.IfExp(test, element, nothing), element)
        bare = ast.comprehension(generator.target, generator.iter, [], generator.is_async)
        each = ast.copy_location(ast.GeneratorExp(element, [bare]), inner)
        element = result = ast.copy_location(ast.Call(call.func, [each], []), call)
    # Where a sum begins is the outermost one's to say.
    result.args += call.args[1:]
    result.keywords = call.keywords
    return result


def _has_parts(target: ast.expr) -> bool:
    """Return whether an assignment writes an element or an attribute."""
    if isinstance(target, (ast.Tuple, ast.List)):
        return any(map(_has_parts, target.elts))
    return isinstance(target, (ast.Subscript, ast.Attribute))


def _arguments(args: ast.arguments) -> list[ast.arg]:
    every = [*args.posonlyargs, *args.args, *args.kwonlyargs]
    return every + [a for a in (args.vararg, args.kwarg) if a is not None]


def _placed(new: _Node, node: ast.AST) -> _Node:
    """Give every part of what was parsed from a text the place where a node begins.

    To Python, the call of an attribute that goes over several lines is in the last of them.
    """
    begin = {"lineno": node.lineno, "col_offset": node.col_offset}  # type: ignore[attr-defined]
    end = {f"end_{name}": number for name, number in begin.items()}
    for part in ast.walk(new):
        if "lineno" in part._attributes:
            vars(part).update(begin | end)
    return new


class _Filling(ast.NodeTransformer):
    """Puts something where a text has ``_.name``: an expression or, where that is a statement, several."""

    def __init__(self, holes: Mapping[str, Any]) -> None:
        self.holes = holes

    def visit(self, node: ast.AST) -> Any:
        match node:
            case ast.Attribute(value=ast.Name(id="_"), attr=name):
                return self.holes[name]
            case ast.Expr(value=ast.Attribute(value=ast.Name(id="_"), attr=name)):
                return self.holes[name]
        return self.generic_visit(node)


def _filled(text: str, node: ast.AST, **holes: ast.expr | list[ast.stmt]) -> list[ast.stmt]:
    """Return the statements of a text, as if they stood where a node begins, and what its holes hold."""
    module = _placed(ast.parse(textwrap.dedent(text)), node)
    body: list[ast.stmt] = _Filling(holes).visit(module).body
    return body


def _expression(function: str, args: Sequence[ast.expr], node: ast.AST) -> ast.expr:
    new = ast.parse(f"{function}()", mode="eval").body
    assert isinstance(new, ast.Call)
    _placed(new, node)
    new.args = list(args)
    return new


def _tuple(names: Sequence[str]) -> str:
    """Return the text of a tuple of variables."""
    return f"({''.join(f'{name}, ' for name in names)})"
