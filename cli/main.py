"""The entry point: commands are imported when they run, so that --help answers at once."""

from __future__ import annotations

import errno
import sys
from typing import NoReturn

import click

import mapmyworld
from cli.arguments import british
from cli.exit_codes import EXIT_BAD_INPUT, EXIT_INTERRUPTED, EXIT_USAGE
from cli.interrupts import Interrupted, forget_interrupts, heed_interrupts, is_interrupted
from cli.lazy import LazyGroup
from cli.standard_streams import mend_streams
from mapmyworld.errors import MapMyWorldError
from mapmyworld.heap import share_one_heap

# Command -> (module:attribute, one line for the list of commands).
COMMANDS = {
    "build": ("cli.build:build", "Turn a recorded log into a map."),
    "inspect": ("cli.inspect:inspect", "Show what is in a log, a graph, a node or a map."),
    "export": ("cli.export:export", "Write grids, clouds, trajectories, graphs, images, reports."),
    "optimise": ("cli.optimise:optimise", "Optimise a pose graph: g2o, TORO or a map."),
    "edit": ("cli.edit:edit", "Accept, reject or add constraints from a text file."),
    "localise": ("cli.localise:localise", "Find where a robot was in a finished map."),
    "merge": ("cli.merge:merge", "Join the sessions of several maps in one."),
    "evaluate": ("cli.evaluate:evaluate", "Score a trajectory, a grid or a map against the truth."),
    "check": ("cli.check:check", "Gates for scripts: exit code 4 when a requirement fails."),
    "batch": ("cli.batch:batch", "Many logs: build, check and sum up; goes on where it stopped."),
    "compare": ("cli.compare:compare", "Several maps of one log side by side."),
    "simulate": ("cli.simulate:simulate", "Record a log, with its truth, in a simulated world."),
    "convert": ("cli.convert:convert", "Write any readable log as MCAP or ROS bag."),
    "config": ("cli.config:config", "Print every setting with its default and meaning."),
    "completion": ("cli.completion:completion", "Print the script for tab completion."),
    "doctor": ("cli.doctor:doctor", "Say whether this machine is ready."),
}


@click.group(
    cls=LazyGroup,
    table=COMMANDS,
    context_settings={
        "help_option_names": ["-h", "--help"],
        "show_default": True,
        "token_normalize_func": british,
    },
)
@click.version_option(mapmyworld.__version__, prog_name="mapmyworld")
def group() -> None:
    """Turn a recorded robot log into a map, offline.

    \b
    mapmyworld build log.mcap       makes map.db, map.html, map.pgm + map.yaml, map.ply, map.tum
    mapmyworld inspect graph        shows nodes and constraints, and why some were rejected
    mapmyworld export grid          writes the grid again, as Nav2 loads it
    """


def main() -> None:
    """Runs a command; every error of ours becomes one message on stderr and an exit code."""
    mend_streams()
    share_one_heap()
    heed_interrupts()
    try:
        _run()
    except (MapMyWorldError, OSError, ImportError, MemoryError) as error:
        click.echo(f"mapmyworld: {_in_words(error)}", err=True)
        sys.exit(EXIT_BAD_INPUT)
    except click.ClickException as error:
        error.show()
        sys.exit(EXIT_USAGE)
    except (click.Abort, KeyboardInterrupt, Interrupted):
        forget_interrupts()
        click.echo("mapmyworld: interrupted; the same command goes on with this stage", err=True)
        sys.exit(EXIT_INTERRUPTED)
    finally:
        forget_interrupts()


def _run() -> NoReturn:
    try:
        sys.exit(group.main(prog_name="mapmyworld", standalone_mode=False))
    except Exception as error:
        if is_interrupted():
            raise Interrupted from error
        raise


def _in_words(error: Exception) -> str:
    """What went wrong, of a file as the system reports it, and what to do."""
    if isinstance(error, ImportError):
        # Little memory is enough for it, not only a bad installation.
        return f"cannot be loaded whole ({error}): `mapmyworld doctor`"
    if isinstance(error, MemoryError):
        return "out of memory: close other programs, or use a larger machine"
    if not isinstance(error, OSError):
        return str(error)
    suggestions = {
        errno.ENOSPC: "free some space and give the same command again",
        errno.EDQUOT: "free some space and give the same command again",
        errno.EROFS: "give another place with -o",
        errno.EACCES: "change its permissions or give another place",
        errno.ENOENT: "check that it was not moved or removed",
        errno.EIO: "check the disk or the network it is on",
    }
    suggestion = suggestions.get(error.errno or 0, "check the file and its disk")
    place = f"{error.filename}: " if error.filename else ""
    return f"{place}{error.strerror or error}: {suggestion}"


if __name__ == "__main__":
    main()
