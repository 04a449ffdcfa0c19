"""The exported functions of a task that only call others, in C or JavaScript."""

from __future__ import annotations

from collections.abc import Mapping


class Body:
    """Lines that call routines, in C or JavaScript."""

    def __init__(self, c: bool) -> None:
        self.c = c
        self.lines: list[str] = []
        self._own: set[str] = set()

    def new(self, kind: str, name: str) -> None:
        self._own.add(name)
        self.lines.append(f"{{p}}_{kind} {name};" if self.c else f"const {name} = new_{kind}();")

    def call(self, routine: str, *names: str) -> str:
        handed = ", ".join(f"&{name}" if self.c and name in self._own else name for name in names)
        return f"{'{p}_' if self.c else ''}{routine}({handed});"

    def copy(self, to: str, given: str) -> str:
        if not self.c:
            return f"Object.assign({to}, {given});"
        return " = ".join(name if name in self._own else f"*{name}" for name in (to, given)) + ";"

    def number(self, name: str, value: str) -> str:
        value = value.replace("rules.", "rules->") if self.c else value
        return f"{'double' if self.c else 'let'} {name} = {value};"


def step(c: bool, with_companions: bool, with_own: bool, with_settings: bool) -> str:
    body = Body(c)
    body.new("action", "held")
    body.new("begun", "begun")
    body.new("state", "now")
    own = ["own"] if with_own else []
    world = ["car", "rules", *(["settings"] if with_settings else [])]
    if with_own:
        body.new("task_state", "own")
        body.lines.append(body.copy("own", "task_state"))
    if with_companions:
        body.new("task_state", "beside")
    body.lines += [
        body.copy("now", "state"),
        body.call("steered", "held", "action", "rules"),
        body.call("begin", "begun", "now", "episode", *own, "held", *world),
        body.number("timestep", "rules.control_timestep / rules.substeps"),
        body.number("elapsed", "0.0 * timestep"),
        f"for ({'int' if c else 'let'} k = 0; k < rules{'->' if c else '.'}substeps; k++) {{",
    ]
    inner = []
    if with_companions:
        inner.append(body.call("accompany", "beside", "now", "episode", *own, "elapsed", *world))
    inner.append(body.call("advance", "now", "now", "episode", *own, "begun", "elapsed", *world))
    if with_companions:
        inner.append(body.copy("own", "beside"))
    inner.append("elapsed = elapsed + timestep;")
    body.lines += [f"    {line}" for line in inner]
    given = ["next_episode", *(["next_task_state"] if with_own else []), "outcome"]
    body.lines += [
        "}",
        body.call("finish", *given, "now", "episode", *own, "held", "begun", *world),
        body.copy("next", "now"),
    ]
    return "\n".join(body.lines)


def observe(c: bool, bounds: Mapping[str, float], with_own: bool, with_settings: bool) -> str:
    body = Body(c)
    own = ["task_state"] if with_own else []
    world = ["car", "rules", *(["settings"] if with_settings else [])]
    body.lines.append(body.call("scaled", "observation", "state", "episode", *own, "scale", *world))
    for name, bound in bounds.items():
        at = f"observation{'->' if c else '.'}{name}"
        single = f"(float){at}" if c else f"Math.fround({at})"
        body.lines.append(f"{at} = {single};")
        body.lines.append(f"if ({at} > {bound!r}) {at} = {bound!r}; else if ({at} < {-bound!r}) {at} = {-bound!r};")
    return "\n".join(body.lines)
