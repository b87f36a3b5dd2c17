"""`unifeed teach`: the lesson of a running session, from a terminal."""

from __future__ import annotations

import argparse
import os
import sys

from unifeed_ros.cli.arguments import UserMistake

ESCAPE_MS = "25"
"""How long a terminal waits for the rest of a key that begins like Esc, which is STOP [ms]."""


def add_teach_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `teach` to the command line."""
    parser = commands.add_parser(
        "teach", help="teach in a running session from this terminal, also over SSH",
        description="The teaching page's words, buttons and keys, docs/console.md. Ctrl-Q leaves; the session runs on.")
    parser.set_defaults(run=run_teach)


def run_teach(options: argparse.Namespace) -> int:
    """Teach until the person leaves."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UserMistake("input and output", expected="a terminal", got="a file or a pipe",
                          mend="over SSH: ssh -t robot unifeed teach")
    os.environ.setdefault("ESCDELAY", ESCAPE_MS)  # read when textual is imported
    from unifeed_ros.nodes.terminal import run_terminal

    run_terminal()
    return 0
