"""The command ``bicycle-env``: report, cars, leaderboard, play, export, explore. So is ``python -m bicycle_env``."""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import shutil
import sys
import warnings
import webbrowser
from collections.abc import Iterator, Sequence
from typing import Any, NoReturn

from bicycle_env import __version__, leaderboard, report, tires
from bicycle_env.backends import announcements
from bicycle_env.backends.compiled import CompilerDisabledError
from bicycle_env.command_words import (
    EXPLORE,
    EXPLORE_EXAMPLES,
    EXPORT,
    EXPORT_EXAMPLES,
    PLAY,
    PLAY_EXAMPLES,
    REPORT,
    REPORT_EXAMPLES,
)
from bicycle_env.files import anything, checked_output_folder, mapping, parse_json, shown
from bicycle_env.installation import needs
from bicycle_env.physics.lateral import GEOMETRIES
from bicycle_env.physics.validation import whole
from bicycle_env.streams import take_any_text

PROGRAM = "bicycle-env"
SHELLS = ("bash", "zsh", "tcsh")


class UserError(Exception):
    """Something that the user can put right; its text says how."""


class Parser(argparse.ArgumentParser):
    """An argument parser whose complaints are one line."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message} (see {self.prog} --help)")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; 0, or 2 with one line on standard error for a user's mistake, 130 for Ctrl-C."""
    take_any_text()
    try:
        words = parser()
        chosen = words.parse_args(arguments)
        chosen.run(chosen) if chosen.command else _begin(words, chosen.completion)
        sys.stdout.flush()
    except BrokenPipeError:  # `| head` has read enough; nothing is left to say to it when Python ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (UserError, ModuleNotFoundError, CompilerDisabledError) as error:
        return _complain(error)
    except OSError as error:
        return _complain(f"{error.filename}: {error.strerror}" if error.filename else error)
    except KeyboardInterrupt:
        sys.stderr.write("stopped\n")
        return 130
    return 0


def _complain(words: object) -> int:
    sys.stderr.write(f"{PROGRAM}: error: {shown(words, 1000)}\n")  # it may hold what stands in a stranger's file
    return 2


def _begin(words: Parser, shell: str | None) -> None:
    """What is said where no command is given: how to go on, or the completion of a shell."""
    if shell is None:
        words.print_help()
        return
    try:
        import shtab
    except ModuleNotFoundError:
        raise UserError(needs("--completion", "shtab", "completion")) from None
    sys.stdout.write(shtab.complete(words, shell) + "\n")


def parser() -> Parser:
    """The command's words."""
    top = Parser(
        prog=PROGRAM,
        description="Cars at and beyond their stability limit, held against theory.",
        epilog=f"{PROGRAM} COMMAND --help explains a command.",
        allow_abbrev=False,
    )
    top.add_argument("--version", action="version", version=f"{PROGRAM} {__version__}")
    top.add_argument("--completion", choices=SHELLS, help="print a script that completes these words in a shell")
    commands = top.add_subparsers(title="commands", dest="command")

    one = commands.add_parser(
        "report",
        help="numbers, and a page with pictures, of one car",
        description=REPORT,
        epilog=REPORT_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    _add_car(one)
    one.add_argument("--out", metavar="DIR", help="folder for report.html and its pictures; made if needed")
    one.add_argument("--json", action="store_true", help="print the numbers as JSON")
    one.add_argument(
        "--grid",
        type=int,
        default=report.GRID,
        metavar="N",
        help=f"nodes per axis of the recoverable set; fewer are faster and coarser; default: {report.GRID}",
    )
    one.add_argument("--quiet", action="store_true", help="do not say what is being done")
    one.set_defaults(run=run_report)

    listing = commands.add_parser(
        "vehicles",
        help="the cars that come with the package",
        description="The cars that come with the package: what the report's --vehicle takes by name.",
        allow_abbrev=False,
    )
    listing.add_argument("--json", action="store_true", help="print all their parameters as JSON")
    listing.set_defaults(run=run_vehicles)

    board = commands.add_parser(
        "leaderboard",
        help="trained policies and classical controllers, by id and level",
        description="How well the trained policies that come with the package drive, and the classical controllers, by "
        "id and level; 95 % intervals. A score is 0 for the best classical controller and 1 for the best found; there "
        "is none where they are three points or less apart. docs/leaderboard.md says more.",
        allow_abbrev=False,
    )
    board.add_argument("--env-id", metavar="ID", help="only of this id, such as BicycleStab-v0")
    board.add_argument("--json", action="store_true", help="print all that the file holds of them as JSON")
    board.set_defaults(run=run_leaderboard)
    _add_play(commands)
    _add_export(commands)
    _add_explore(commands)
    return top


def _add_play(commands: Any) -> None:
    show = commands.add_parser(
        "play",
        help="watch policies drive, in a window or a file, or steer yourself",
        description=PLAY,
        epilog=PLAY_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    show.add_argument("--env-id", default="BicycleStab-v0", metavar="ID", help="default: BicycleStab-v0")
    show.add_argument("--level", metavar="LEVEL", help="easy, medium or hard")
    show.add_argument(
        "--env-keywords", default="{}", metavar="JSON", help="more keywords, for example '{\"friction\": 0.5}'"
    )
    show.add_argument("--policy", nargs="+", default=["lqr"], metavar="NAME", help="who drives; default: lqr")
    show.add_argument(
        "--rear", metavar="NAME", help="with the policy human: who steers the rear wheels; default: they stay straight"
    )
    show.add_argument("--out", metavar="FILE", help="a file that ends in .gif, .mp4 or .npz; without: a window")
    show.add_argument("--starts", type=int, default=1, metavar="N", help="how many, one after the other; default: 1")
    show.add_argument("--seed", type=int, default=0, metavar="N", help="of the first start; default: 0")
    show.set_defaults(run=run_play)


def _add_car(to: argparse.ArgumentParser) -> None:
    """The words for one car at one speed on one road."""
    to.add_argument(
        "--vehicle",
        default="oversteer",
        metavar="NAME|FILE",
        help="a preset (see bicycle-env vehicles), or a file: .json, .toml, or CommonRoad's .yaml; default: oversteer",
    )
    speed = to.add_mutually_exclusive_group()
    speed.add_argument("--speed", type=float, metavar="M/S", help="{:g} to {:g} m/s".format(*report.SPEEDS))
    speed.add_argument(
        "--speed-ratio",
        type=float,
        metavar="RATIO",
        help=f"a multiple of the critical speed; default: {report.DEFAULT_SPEED_RATIO:g}, or "
        f"{report.DEFAULT_SPEED:g} m/s for a car without critical speed",
    )
    to.add_argument(
        "--tire",
        default="fiala",
        metavar="LAW|FILE",
        help=f"{', '.join(tires.LAWS)}, or a .tir file, which sets the car's stiffnesses, too; default: fiala",
    )
    to.add_argument("--friction", type=float, default=1.0, metavar="MU", help="of tire on road; default: 1")


def _add_export(commands: Any) -> None:
    to = commands.add_parser(
        "export",
        help="the car, a task or a policy for C, JavaScript, CasADi, FMI",
        description=EXPORT,
        epilog=EXPORT_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    _add_car(to)
    to.set_defaults(run=run_export, vehicle=None, tire=None, friction=None)
    to.add_argument(
        "--geometry",
        metavar="WORD",
        help=f"{', '.join(GEOMETRIES)}; default: small_angle for the linear tire, exact for the others",
    )
    to.add_argument("--relaxation-length", type=float, metavar="M", help="of tires whose forces lag; default: none lag")
    for axle in ("front", "rear"):
        to.add_argument(
            f"--{axle}-actuator",
            metavar="FIELD=NUMBER,...",
            help="angle_limit [rad], rate_limit [rad/s], time_constant [s]; default: the environments'",
        )
    to.add_argument("--physics-timestep", type=float, metavar="S", help="default: 0.004 s")
    to.add_argument("--pushed", action="store_true", help="the car's side_force and yaw_moment (a gust) act")
    to.add_argument("--env-id", metavar="ID", help="a task, with its own defaults for all above; or a policy's")
    to.add_argument("--level", metavar="WORD", help="of the id: easy, medium or hard")
    to.add_argument(
        "--policy",
        metavar="NAME|FOLDER",
        help="pretrained (that of the id and level), a folder of agents.train, or a linear controller such as lqr, "
        "designed for the car above in the id, by default BicycleStab-v0",
    )
    to.add_argument("--format", required=True, metavar="WORD", help="c, js; of a car also casadi, fmu")
    to.add_argument("--fma", action="store_true", help="c, fmu: a multiply-add rounds once, as in the environments")
    to.add_argument("--out", required=True, metavar="DIR", help="folder for the files; made if needed")
    to.add_argument("--quiet", action="store_true", help="do not say what is being done")


def _add_explore(commands: Any) -> None:
    to = commands.add_parser(
        "explore",
        help="a page in the browser: speed, car, start and drivers at will",
        description=EXPLORE,
        epilog=EXPLORE_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    to.add_argument("--port", type=int, metavar="N", help="of 127.0.0.1; 0: any that is free; default: 8765")
    to.add_argument("--no-browser", action="store_true", help="open none: only say the address")
    to.add_argument("--out", metavar="DIR", help="write the page as files into a folder, made if needed; serve nothing")
    to.set_defaults(run=run_explore)


def run_report(chosen: argparse.Namespace) -> None:
    """``bicycle-env report``."""
    study = _study(chosen)

    def tell(words: str) -> None:
        if not chosen.quiet:
            sys.stderr.write(f"{words}\n")
            sys.stderr.flush()

    page = None
    if chosen.out == "":
        raise UserError("--out must name a folder, got ''")
    if chosen.out is not None:
        checked_output_folder(chosen.out)
    elif not chosen.json:
        tell("for a page with pictures: --out DIR; for machines: --json")
    with announcements.silenced(chosen.quiet):
        if chosen.out is not None:
            page = report.write(study, chosen.out, tell)
        else:
            report.compute(study, tell)
    if chosen.json:
        _write_json(report.as_json(study))
    elif page is None:
        sys.stdout.write(report.as_text(study))
    if page is not None:
        (sys.stderr if chosen.json else sys.stdout).write(f"{page}\n")


def _study(chosen: argparse.Namespace) -> report.Study:
    """What the user asks about; a UserError names what is wrong with it."""
    try:
        with _remarks():
            return report.study(
                chosen.vehicle, chosen.speed, chosen.speed_ratio, chosen.tire, chosen.friction, chosen.grid
            )
    except (ValueError, TypeError) as error:
        raise UserError(str(error)) from None


@contextlib.contextmanager
def _remarks() -> Iterator[None]:
    """What looks wrong with a car, and what of a tire's file is not taken, as lines on standard error."""
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always", UserWarning)
        yield
    for remark in remarks:
        sys.stderr.write(f"{PROGRAM}: remark: {shown(remark.message, 1000)}\n")


def run_vehicles(chosen: argparse.Namespace) -> None:
    """``bicycle-env vehicles``."""
    if chosen.json:
        _write_json(report.vehicles_as_json())
        return
    sys.stdout.write(report.vehicles_as_text(shutil.get_terminal_size().columns))


def run_leaderboard(chosen: argparse.Namespace) -> None:
    """``bicycle-env leaderboard``."""
    try:
        content = leaderboard.read()
        levels = leaderboard.of_id(content["levels"], chosen.env_id)
    except ValueError as error:
        raise UserError(str(error)) from None
    if chosen.json:
        _write_json({**content, "levels": levels})
        return
    sys.stdout.write(leaderboard.as_text(levels))


def run_play(chosen: argparse.Namespace) -> None:
    """``bicycle-env play``."""
    import gymnasium as gym

    from bicycle_env import play

    try:
        keywords = parse_json(chosen.env_keywords, "--env-keywords", mapping(anything))
        level = {} if chosen.level is None else {"level": chosen.level}
        play.play(
            chosen.env_id,
            chosen.policy,
            keywords={**keywords, **level},
            out=chosen.out,
            starts=whole("--starts", chosen.starts),
            seed=whole("--seed", chosen.seed, 0),
            rear=chosen.rear,
            tell=lambda words: (sys.stdout.write(f"{words}\n"), sys.stdout.flush()),
        )
    except (ValueError, TypeError, gym.error.Error, play.NoDisplayError) as error:
        # Gymnasium adds words of its own to what an environment says.
        raise UserError(str(error).partition(" was raised from the environment creator for ")[0]) from None


def run_export(chosen: argparse.Namespace) -> None:
    """``bicycle-env export``."""
    from bicycle_env.export import command

    def tell(words: str) -> None:
        if not chosen.quiet:
            sys.stderr.write(f"{words}\n")

    try:
        with announcements.silenced(chosen.quiet), _remarks():
            paths = command.run(chosen, tell)
    except (ValueError, TypeError) as error:
        raise UserError(str(error)) from None
    sys.stdout.write("".join(f"{path}\n" for path in paths))


def run_explore(chosen: argparse.Namespace) -> None:
    """``bicycle-env explore``."""
    from bicycle_env import explore

    try:
        if chosen.out is not None:
            if chosen.port is not None or chosen.no_browser:
                raise UserError("--port and --no-browser have no meaning with --out: nothing is served")
            sys.stdout.write("".join(f"{path}\n" for path in explore.write(chosen.out)))
            return
        port = explore.USUAL_PORT if chosen.port is None else whole("--port", chosen.port, 0, 65535)
    except ValueError as error:
        raise UserError(str(error)) from None
    sys.stderr.write("making the page\n")
    with explore.Server(explore.page(served=True), port) as server:
        sys.stdout.write(f"{server.url} until Ctrl-C\n")
        sys.stdout.flush()
        if not chosen.no_browser:
            webbrowser.open(server.url)
        server.serve_forever()


def _write_json(content: Any) -> None:
    json.dump(content, sys.stdout, indent=1, allow_nan=False)
    sys.stdout.write("\n")
