"""A page for each program: its commands with their arguments, options and examples, as `--help` shows them."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from myst_text import fence, plain, table

PROGRAMS = ("synthcam", "tracker", "discrepancy")


def pages(root: Path) -> dict[str, str]:
    """By name under docs/generated."""
    made = {f"commands/{name}.md": program(name) for name in PROGRAMS}
    links = "\n".join(PROGRAMS)
    made["commands/index.md"] = (
        "# The commands\n\nWhat `--help` says of each. Files, columns and units: [](../../format.md).\n\n"
        f"```{{toctree}}\n:maxdepth: 2\n\n{links}\n```\n"
    )
    return made


def program(name: str) -> str:
    """All commands of one program."""
    group: Any = typer.main.get_command(import_module(f"{name}.cli").app)
    parts = [f"# {name}\n\n{plain(group.help or '')}\n"]
    parts += [of_command(command, path) for path, command in commands(group, name)]
    return "\n".join(parts)


def commands(group: Any, path: str) -> Any:
    """The commands of a program and those within them, with their full names."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, f"{path} {name}")
        elif not command.hidden:
            yield f"{path} {name}", command


def of_command(command: Any, path: str) -> str:
    """One command: what it does, its arguments and options, its example."""
    doc = inspect.cleandoc(command.help or "").replace("\b", "")
    said, _, example = doc.partition("Example: ")
    parts = [f"## {path}\n", *(plain(p) + "\n" for p in re.split(r"\n\s*\n", said) if p.strip())]
    if example:
        parts.append(fence(" ".join(example.split()), "sh") + "\n")
    rows = [row(p) for p in command.params if not getattr(p, "hidden", False) and p.name != "help"]
    if rows:
        parts.append(table(["argument or option", "what it says", "default"], rows) + "\n")
    return "\n".join(parts)


def row(parameter: Any) -> list[str]:
    """A line of the table: how it is written, what it means, what holds without it."""
    metavar = parameter.metavar or ""
    default = parameter.default
    if parameter.param_type_name == "argument":
        written = f"`{metavar or parameter.name.upper()}`"
    else:
        flag = getattr(parameter, "is_flag", False)
        value = "" if flag else " " + (metavar or parameter.name.strip("_").upper())
        names = sorted(parameter.opts, key=len)
        written = ", ".join(f"`{n}`" for n in names[:-1]) + (", " if names[:-1] else "") + f"`{names[-1]}{value}`"
        default = None if flag and not default else default
    shown = "required" if parameter.required else "" if default in (None, "", [], ()) else f"`{default}`"
    return [written, plain(getattr(parameter, "help", "") or ""), shown]
