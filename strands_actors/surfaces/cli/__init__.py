"""The command ``strands-actors``. Each command imports its modules only when it runs, so that --help is
quick."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from json import dumps as json_of  # Renamed, because the commands below have an option "json".
from pathlib import Path
from typing import Annotated

import typer

from strands_actors.contract.extras import MissingExtra
from strands_actors.surfaces.recording.errors import RecordingError

from .dataset_verbs import datasets
from .errors import Problem
from .options import (
    All,
    Cameras,
    Dialogue,
    Every,
    Id,
    Json,
    Keyframe,
    Kind,
    Mesh,
    Model,
    Onboard,
    Policy,
    PolicyHz,
    PolicyOptions,
    Running,
    What,
    Which,
    cameras_of,
    finite,
    one_or_all,
    scene_of,
    settings_of,
)
from .stop_forms import spelled

USAGE = 2
INTERRUPTED = 130

app = typer.Typer(
    name="strands-actors",
    help="Run, watch, stop and record robots.",
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def _version(is_given: bool) -> None:
    if is_given:
        from strands_actors.version import __version__

        print(f"strands-actors {__version__}")
        raise typer.Exit


@app.callback()
def options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Run, watch, stop and record robots."""


@app.command()
def demo(
    seconds: Annotated[
        float, typer.Option(min=6.0, callback=finite, help="Length in seconds, without the start of processes.")
    ] = 12.0,
    no_faults: Annotated[bool, typer.Option("--no-faults", help="Run only the policy, without faults.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
    out: Annotated[Path, typer.Option(help="The file for the picture.")] = Path("demo.png"),
) -> None:
    """Show how a simulated arm stops when its processes are killed or frozen, with measured times."""
    from .demo import run

    raise typer.Exit(run(seconds, faults=not no_faults, as_json=json, out=out))


@app.command("list")
def list_(all_: Every = False, json: Json = False) -> None:
    """List the robots that this machine can drive, and by which driver."""
    from .robots import show_robots

    show_robots(as_json=json, every=all_)


@app.command()
def tree(json: Json = False) -> None:
    """Show the running robots: their processes and actors."""
    from .trees import show_trees

    raise typer.Exit(show_trees(as_json=json))


@app.command()
def top() -> None:
    """Show the running robots live. Keys stop, e-stop or resume the selected robot."""
    from .top import run as show

    raise typer.Exit(show())


@app.command()
def doctor(json: Json = False) -> None:
    """Check if this computer has everything to run robots, with remedies."""
    from .doctor import run as examine

    raise typer.Exit(examine(as_json=json))


@app.command()
def stop(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """De-energise a robot."""
    from .orders import stop as run

    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def estop(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """De-energise every robot, or one robot, and lock it until `resume`."""
    from .orders import estop as run

    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def resume(robot: Which = None, all_: All = False, mesh: Mesh = None, json: Json = False) -> None:
    """Lift the lock of an e-stop, and energise a robot. It does not start to move."""
    from .orders import resume as run

    one_or_all("resume", robot, all_)
    raise typer.Exit(run(robot, all_, mesh, as_json=json))


@app.command()
def echo(
    robot_or_key: What,
    mesh: Mesh = None,
    json: Json = False,
    count: Annotated[int | None, typer.Option(min=1, help="End after this many samples.")] = None,
    timeout: Annotated[
        float | None,
        typer.Option(min=0.1, callback=finite, help="End when no sample arrives for this many seconds."),
    ] = None,
) -> None:
    """Show what a robot publishes."""
    from .listen import echo as run

    run(robot_or_key, mesh, as_json=json, count=count, timeout_s=timeout)


@app.command()
def view(
    robot: Running,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve Foxglove, which then shows the robot.")
    ] = False,
    host: Annotated[
        str, typer.Option(help="Address for Foxglove. Every program that reaches it can read the telemetry.")
    ] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port for Foxglove. 0: a free one.")] = 8765,
    rerun: Annotated[bool, typer.Option("--rerun", help="Show the robot in Rerun.")] = False,
    save: Annotated[
        Path | None, typer.Option(metavar="FILE.rrd", help="With --rerun: write a recording, and open no window.")
    ] = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait until the robot runs.")] = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, callback=finite, help="End after this many seconds.")
    ] = None,
    cameras: Annotated[bool, typer.Option(help="Show the robot's cameras.")] = True,
    model: Annotated[bool, typer.Option(help="Show the robot's model in 3-D.")] = True,
    model_file: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The model file (MJCF or URDF) of a robot that is simulated from it."),
    ] = None,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Show a running robot live in Foxglove or Rerun: joints, 3-D model, cameras, events. It only reads."""
    from .view import Choice
    from .view import view as run

    file = "" if model_file is None else str(model_file)
    run(Choice(robot, foxglove, rerun, host, port, save, wait, seconds, cameras, model, file), mesh, as_json=json)


@app.command()
def metrics(
    host: Annotated[str, typer.Option(help="Address to listen at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen at. 0: a free one.")] = 9464,
    traces: Annotated[
        str,
        typer.Option(metavar="URL", help="Send stops as OpenTelemetry traces, to a collector of OTLP over HTTP."),
    ] = "",
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Serve the metrics of all running robots for Prometheus. Nothing is asked of the robots' wires."""
    from .metrics import metrics as run

    run(host, port, traces, mesh, as_json=json)


@app.command()
def web(
    robot: Annotated[
        str, typer.Argument(metavar="[ROBOT]", help="The robot to show first. Default: the list of all robots.")
    ] = "",
    twin: Annotated[
        list[str] | None, typer.Option(metavar="TYPE", help="Start a simulated robot, too. Can be repeated.")
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65532, help="Port of the page; the e-stop gets the next one. 0: free ones.")
    ] = 8390,
    lan: Annotated[bool, typer.Option("--lan", help="Let other devices in, over TLS and with a code.")] = False,
    name: Annotated[
        str, typer.Option(help="With --lan: name or address of this computer. Default: its address.")
    ] = "",
    recordings: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of datasets and recordings. Default: one of yours.")
    ] = None,
    model_file: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=FILE", help="Draw a robot by this MJCF or URDF. Can be repeated."),
    ] = None,
    agent: Annotated[
        str, typer.Option(metavar="MODULE:FUNCTION", help="Your function that makes an agent for the page.")
    ] = "",
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Serve a page on which a person watches, stops and moves the running robots."""
    from .web import Choice
    from .web import web as run

    choice = Choice(robot, twin or [], port, lan, name, recordings, agent, model_file or [])
    run(choice, mesh, as_json=json)


@app.command()
def trace(
    robot: Annotated[str, typer.Argument(help="The robot's name, as `tree` shows it.")],
    count: Annotated[int | None, typer.Option(min=1, help="End after this many messages.")] = None,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, callback=finite, help="End after this many seconds.")
    ] = None,
    json: Json = False,
) -> None:
    """Print the messages between a robot's actors: sender, receiver, type, age. For this user's robots
    only."""
    from .trace import trace as run

    run(robot, json, count, seconds)


@app.command()
def hz(
    robot_or_key: What,
    mesh: Mesh = None,
    json: Json = False,
    seconds: Annotated[
        float | None, typer.Option(min=0.1, callback=finite, help="Listen for this many seconds, then end.")
    ] = None,
) -> None:
    """Measure how often a robot publishes each topic."""
    from .listen import hz as run

    run(robot_or_key, mesh, as_json=json, seconds=seconds)


@app.command()
def send(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="The robot's name, as `mesh status` shows it.")],
    targets: Annotated[list[str], typer.Argument(metavar="JOINT=NUMBER...", help="Targets in the robot's units.")],
    seconds: Annotated[
        float,
        typer.Option(
            "--for", min=0.0, callback=finite, help="Command the robot for this many seconds. Then it holds."
        ),
    ] = 2.0,
    resume: Annotated[
        bool, typer.Option("--resume", help="Energise the robot first, also after an e-stop.")
    ] = False,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Move a running robot that no other program commands."""
    from .send import send as run

    raise typer.Exit(run(robot, targets, seconds, resume, mesh, as_json=json))


@app.command()
def up(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="TOML file with a table [robot.NAME] for each robot.")
    ],
    check: Annotated[
        bool, typer.Option("--check", help="Only look for faults of the file. Nothing is started.")
    ] = False,
    new_adapters: Annotated[
        bool, typer.Option("--new-adapters", help="Forget which USB adapter each robot had. Use it after a repair.")
    ] = False,
    json: Json = False,
) -> None:
    """Keep the robots of a file, for scripts that come and go. Nothing is energised."""
    from .host import up as run

    raise typer.Exit(run(file, check, new_adapters, as_json=json))


@app.command("status")
def status_of_host(json: Json = False) -> None:
    """Show the robots of this user's host (`up`), and why one is not up."""
    from .host import status as run

    raise typer.Exit(run(as_json=json))


@app.command()
def reload(json: Json = False) -> None:
    """Let the host (`up`) read its file again. Only robots that changed are stopped and started."""
    from .host import reload as run

    raise typer.Exit(run(as_json=json))


@app.command()
def down(json: Json = False) -> None:
    """Make the robots of the host (`up`) safe, and end it."""
    from .host import down as run

    raise typer.Exit(run(as_json=json))


@app.command()
def install(
    systemd: Annotated[bool, typer.Option("--systemd", help="The unit that starts the host (`up`).")] = False,
    udev: Annotated[
        bool, typer.Option("--udev", help="Rules for serial adapters: names by serial number, and permissions.")
    ] = False,
    file: Annotated[Path | None, typer.Option(metavar="FILE", help="The host's file, for --systemd.")] = None,
    user: Annotated[
        str | None, typer.Option(metavar="NAME", help="The ordinary user that the host and its scripts run as.")
    ] = None,
    below: Annotated[
        Path, typer.Option(metavar="DIR", help="The root directory to write to, such as that of an image.")
    ] = Path("/"),
    yes: Annotated[bool, typer.Option("--yes", help="Write the files. Without it they are only printed.")] = False,
    json: Json = False,
) -> None:
    """Print the systemd unit and the udev rules for the host (`up`), or write them."""
    from .install import install as run

    raise typer.Exit(run(systemd, udev, file, user, below, yes, as_json=json))


@app.command("run")
def run_(
    robot: Kind,
    policy: Policy,
    seconds: Annotated[
        float, typer.Option(min=0.01, callback=finite, help="Duration from the policy's first action.")
    ] = 10.0,
    instruction: Annotated[str, typer.Option(help="The task, for the policy.")] = "",
    hz: PolicyHz = None,
    option: PolicyOptions = None,
    port: Annotated[str | None, typer.Option(help="Serial port or address of a real robot.")] = None,
    twin: Annotated[
        bool, typer.Option("--twin", help="Use the robot's twin. Without --twin and --port: a simulation.")
    ] = False,
    max_age: Annotated[
        float,
        typer.Option(
            "--max-age", min=0.01, callback=finite, help="Largest age (s) of the reading behind a sent action."
        ),
    ] = 10.0,
    camera: Cameras = None,
    model: Model = None,
    keyframe: Keyframe = None,
    onboard: Onboard = None,
    id_: Id = None,
    json: Json = False,
) -> None:
    """Let a policy control a robot for some seconds. Ctrl-C ends it. The robot is de-energised at the end."""
    from .one_robot import OneRobot
    from .run_policy import run_policy

    scene = scene_of(model, keyframe, onboard)
    chosen = OneRobot(robot, port, twin, id_, cameras_of("run", camera or ()), scene)
    options = settings_of("run", option or ())
    raise typer.Exit(run_policy(chosen, policy, seconds, instruction, hz, max_age, options, as_json=json))


@app.command("eval")
def eval_(
    robot: Kind,
    policy: Policy,
    success: Annotated[
        str,
        typer.Option(metavar="MODULE:FUNCTION", help="Returns True if the state of an episode is a success."),
    ],
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 20,
    seconds: Annotated[
        float, typer.Option(min=0.01, callback=finite, help="Longest simulated time of an episode.")
    ] = 10.0,
    scene: Annotated[
        str | None,
        typer.Option(metavar="MODULE:FUNCTION", help="Prepares each episode: objects, light, cameras, start pose."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first episode; the next ones count up.")] = 0,
    instruction: Annotated[str, typer.Option(help="The task, for the policy.")] = "",
    hz: PolicyHz = None,
    option: PolicyOptions = None,
    camera: Cameras = None,
    model: Model = None,
    keyframe: Keyframe = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for results.json and a film of each episode that was not won."),
    ] = None,
    json: Json = False,
) -> None:
    """Run a policy in simulated episodes, which can be repeated, and print a table of their results."""
    from .evaluate import Request, evaluate
    from .one_robot import OneRobot

    chosen = OneRobot(robot, None, False, None, None, scene_of(model, keyframe, None))
    cameras = cameras_of("eval", camera or ()) or {}
    options = settings_of("eval", option or ())
    request = Request(
        chosen, policy, options, cameras, episodes, seconds, seed, success, scene, instruction, hz, out
    )
    raise typer.Exit(evaluate(request, as_json=json))


@app.command()
def calibrate(
    robot: Kind,
    port: Annotated[str, typer.Option(help="The robot's serial port.")],
    id_: Id = None,
    accept: Annotated[
        list[str] | None,
        typer.Option(
            metavar="JOINT|firmware",
            help="Accept another range of this joint than usual, or different firmware. Can be repeated.",
        ),
    ] = None,
    from_: Annotated[
        Path | None,
        typer.Option("--from", metavar="FILE", help="Write this calibration file of LeRobot into the servos."),
    ] = None,
    undo: Annotated[
        bool, typer.Option("--undo", help="Put back the values that the servos had before the last calibration.")
    ] = False,
    dialogue: Dialogue = False,
    json: Json = False,
) -> None:
    """Calibrate the joints of a robot or a leader, by moving them by hand."""
    from .calibrate import calibrate as run

    raise typer.Exit(run(robot, port, id_, json or dialogue, accept or (), from_, undo, dialogue))


@app.command("setup-motors")
def setup_motors(
    robot: Kind,
    port: Annotated[str, typer.Option(help="The robot's serial port.")],
    joint: Annotated[list[str] | None, typer.Option(help="Set up only this joint. Can be repeated.")] = None,
    dialogue: Dialogue = False,
    json: Json = False,
) -> None:
    """Give new servos their ids, one after the other."""
    from .calibrate import setup_motors as run

    raise typer.Exit(run(robot, port, joint or [], json or dialogue, dialogue))


@app.command()
def rest(
    robot: Kind,
    port: Annotated[str | None, typer.Option(help="The robot's serial port. Needed with --teach.")] = None,
    id_: Id = None,
    teach: Annotated[
        bool, typer.Option("--teach", help="Record the pose: the torque is switched off, lay the arm down by hand.")
    ] = False,
    json: Json = False,
) -> None:
    """Show or teach the pose to which an arm is lowered before its torque is switched off."""
    from .rest import rest as run

    raise typer.Exit(run(robot, port, id_, teach, json))


@app.command()
def ports(
    also: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Also look at this device path, with wildcards. Can be repeated."),
    ] = None,
    json: Json = False,
) -> None:
    """Find the serial port of a robot: you unplug its adapter, and the port is printed."""
    from .calibrate import ports as run

    raise typer.Exit(run(also or [], json))


@app.command()
def teleop(
    robot: Kind,
    leader: Annotated[
        str,
        typer.Option(
            "--from",
            metavar="LEADER",
            help="A leader arm: NAME:PORT or NAME:PORT:ID. Others: keyboard, lerobot:TYPE, module:Class. "
            "A web page: page, gamepad or phone, with :ADDRESS:PORT to serve it in your network.",
        ),
    ],
    port: Annotated[str | None, typer.Option(help="Serial port or address of a real robot.")] = None,
    twin: Annotated[
        bool, typer.Option("--twin", help="Use the robot's twin. Without --twin and --port: a simulation.")
    ] = False,
    deadman: Annotated[
        str | None, typer.Option(help="`key`: the space bar. `gripper`: the leader's gripper.")
    ] = None,
    relative: Annotated[
        bool, typer.Option("--relative", help="Move relative to the positions when you engage.")
    ] = False,
    hz: Annotated[float, typer.Option(callback=finite, help="Setpoints per second.")] = 100.0,
    max_speed: Annotated[
        float | None,
        typer.Option(callback=finite, help="Largest speed in degrees per second. Faster frames are refused."),
    ] = None,
    map_: Annotated[
        str | None,
        typer.Option("--map", metavar="MODULE:FUNCTION", help="Converts the leader's positions to the robot's."),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(min=0.0, callback=finite, help="Duration in seconds. Default: until a key is pressed."),
    ] = None,
    camera: Cameras = None,
    id_: Id = None,
    leader_id: Annotated[
        str | None, typer.Option(help="The leader's id, under which it was calibrated (`calibrate --id`).")
    ] = None,
    json: Json = False,
) -> None:
    """Teleoperate a robot by a leader arm or by keys. It moves only while you hold the dead-man switch."""
    from .one_robot import OneRobot
    from .teleop import teleop as run

    follower = OneRobot(robot, port, twin, id_, cameras_of("teleop", camera or ()))
    led_by = leader, leader_id
    raise typer.Exit(run(follower, led_by, deadman, relative, hz, max_speed, map_, seconds, json))


meshes = typer.Typer(
    name="mesh", help="List the robots on the mesh, and make certificates for it.", add_completion=False
)
app.add_typer(meshes)


@meshes.command()
def status(mesh: Mesh = None, json: Json = False) -> None:
    """List the robots on the mesh."""
    from .mesh import status as run

    run(mesh, as_json=json)


@meshes.command()
def keys(
    directory: Annotated[Path, typer.Argument(help="The folder for the certificates and keys.")],
    robot: Annotated[
        list[str] | None, typer.Option(help="The name of a robot on the mesh. Can be repeated.")
    ] = None,
    host: Annotated[
        list[str] | None, typer.Option(help="A name or address of the robots' host. Can be repeated.")
    ] = None,
    name: Annotated[
        list[str] | None, typer.Option(help="The name of another operator or viewer. Can be repeated.")
    ] = None,
    days: Annotated[int, typer.Option(min=1, max=36_500, help="Validity of the certificates in days.")] = 365,
    json: Json = False,
) -> None:
    """Make a certificate authority, and certificates for robots, an operator and a viewer. Run this again
    to add robots: the authority is kept."""
    from .mesh import keys as run

    run(directory, robot or [], host or [], name or [], days, as_json=json)


@app.command()
def record(
    context: typer.Context,
    robot: Annotated[str, typer.Argument(help="The robot's name, as `tree` shows it.")],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="The MCAP file. It must not exist yet.")] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            callback=finite,
            help="Duration in seconds. For a dataset: of each episode. Default: until Ctrl-C.",
        ),
    ] = None,
    dataset: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Record a dataset into this folder, in LeRobot's format.")
    ] = None,
    task: Annotated[str, typer.Option(help="For a dataset: the task that is shown, in a sentence.")] = "",
    episodes: Annotated[
        int | None, typer.Option(min=1, help="For a dataset: end after this many episodes.")
    ] = None,
    fps: Annotated[int, typer.Option(min=1, max=240, help="For a dataset: frames per second.")] = 30,
    camera: Annotated[
        list[str] | None, typer.Option(help="For a dataset: the name of a camera of the robot. Can be repeated.")
    ] = None,
    codec: Annotated[
        str | None,
        typer.Option(
            help="For a dataset: av1, or mpeg4 for a slow processor. An existing dataset keeps its codec."
        ),
    ] = None,
    copy_to: Annotated[
        str | None,
        typer.Option(
            metavar="PLACE",
            help="For a dataset: copy each finished episode to this folder, s3://BUCKET/FOLDER or "
            "hf://datasets/USER/NAME.",
        ),
    ] = None,
    keys: Annotated[
        str | None,
        typer.Option(
            metavar="page|gamepad|phone",
            help="For a dataset: also show the keys on a web page. Add :ADDRESS:PORT for another address.",
        ),
    ] = None,
    json: Json = False,
) -> None:
    """Record all commands, decisions and actions of a running robot, or episodes for training."""
    if (out is None) == (dataset is None):
        options = "-o FILE, or --dataset DIR" if out is None else "-o FILE or --dataset DIR: one of the two"
        raise Problem(f"record: give {options}")
    if dataset is not None:
        from strands_actors.surfaces.dataset.order import Order
        from strands_actors.surfaces.dataset.second.place import absolute_url

        from .dataset import record as record_dataset

        order = Order(
            robot,
            os.path.abspath(dataset),
            task,
            fps,
            tuple(camera or ()),
            codec,
            episodes,
            seconds,
            absolute_url(copy_to or ""),
        )
        raise typer.Exit(record_dataset(order, keys, as_json=json))
    of_datasets = ("task", "episodes", "fps", "camera", "codec", "copy_to", "keys")
    sources = {name: context.get_parameter_source(name) for name in of_datasets}
    unusable = [name for name, source in sources.items() if source is not None and source.name != "DEFAULT"]
    if unusable:
        named = ", --".join(name.replace("_", "-") for name in unusable)
        raise Problem(f"record: --{named}: of a dataset's episodes. Give --dataset DIR")
    assert out is not None
    from .record import record as run

    raise typer.Exit(run(robot, out, seconds, as_json=json))


app.add_typer(datasets)


@app.command()
def replay(
    recording: Annotated[Path, typer.Argument(help="A file that `record` wrote.")],
    json: Json = False,
) -> None:
    """Make every decision of a recording again, and compare it with the recorded decision."""
    from .record import replay as run

    raise typer.Exit(run(recording, as_json=json))


@app.command()
def twin(
    robot: Kind,
    port_file: Annotated[
        Path | None, typer.Option(help="The twin writes its port or address into this file.")
    ] = None,
    log: Annotated[Path | None, typer.Option(help="File for the frames on the wire, one JSON line each.")] = None,
    fault: Annotated[
        str | None, typer.Option(metavar="WORD[:servo]", help="A fault that the twin has from the beginning.")
    ] = None,
    option: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="An option of the twin. Can be repeated.")
    ] = None,
    control: Annotated[
        Path | None,
        typer.Option(help="Path of a socket for `move_by_hand` of strands_actors.testing, which moves the joints."),
    ] = None,
    parent_fd: Annotated[int | None, typer.Option(hidden=True, help="Ends with the twin's parent.")] = None,
    about: Annotated[
        bool, typer.Option("--about", help="Print what the twin models of the robot's protocol, and do not run it.")
    ] = False,
) -> None:
    """Run a simulated robot, which drivers can connect to, until interrupted. `twin-order` changes it."""
    if about:
        from .about import show_twin

        show_twin(robot)
        return
    if port_file is None:
        raise typer.BadParameter("give a file for the twin's port", param_hint="--port-file")
    from .robots import serve_twin

    serve_twin(robot, port_file, log, fault, parent_fd, control, option or [], takes_orders=True)


@app.command("twin-order")
def twin_order(
    port_file: Annotated[Path, typer.Argument(help="The file that was given to `twin --port-file`.")],
    words: Annotated[
        list[str],
        typer.Argument(
            metavar="ORDER...",
            help="`unplug`, `plug`, `power-cycle`, `freeze SECONDS`, `fault WORD`, or an order of this twin alone.",
        ),
    ],
) -> None:
    """Pull the cable of a running twin, switch its power, or give it a fault."""
    from .robots import order_twin

    order_twin(port_file, words)


@app.command()
def mcp(
    robot: Annotated[
        str | None, typer.Argument(metavar="[ROBOT]", help="The robot's type, as `list` shows it.")
    ] = None,
    port: Annotated[str | None, typer.Option(help="Serial port or address of a real robot.")] = None,
    transport: Annotated[str | None, typer.Option(help="`twin`: the robot's twin, behind its real driver.")] = None,
    id_: Id = None,
    allow_motion: Annotated[
        bool, typer.Option("--allow-motion", help="Energise the robot, and accept motion.")
    ] = False,
    all_: Annotated[
        bool, typer.Option("--all", help="One tool for all running robots. It energises none.")
    ] = False,
    mesh: Mesh = None,
) -> None:
    """Serve a robot, or all running robots, as a tool over MCP, on standard input and output."""
    from .mcp import serve_fleet, serve_mcp

    one_or_all("mcp", robot, all_)
    if robot is not None:
        serve_mcp(robot, port, transport, id_, allow_motion)
    elif all_:
        serve_fleet(mesh, allow_motion)
    else:
        raise Problem("mcp: no robot is given. Give the type of a robot, or --all")


@app.command()
def ros2(
    robot: Annotated[
        list[str] | None, typer.Argument(metavar="[ROBOT...]", help="Robots to show. Default: all running robots.")
    ] = None,
    domain: Annotated[int, typer.Option(min=0, max=232, help="The ROS domain.")] = 0,
    namespace: Annotated[str, typer.Option(help="The namespace of the robots' nodes, such as /lab.")] = "",
    router: Annotated[
        str, typer.Option(metavar="ENDPOINT", help="The zenoh router of the graph, which `rmw_zenohd` is.")
    ] = "tcp/localhost:7447",
    humble: Annotated[
        bool, typer.Option("--humble", help="Speak to ROS 2 Humble, which has no type hashes.")
    ] = False,
    allow_motion: Annotated[
        bool, typer.Option("--allow-motion", help="Let every program of the graph resume and move the robots.")
    ] = False,
    mesh: Mesh = None,
    json: Json = False,
) -> None:
    """Show running robots on a ROS 2 graph (rmw_zenoh), until interrupted. ROS need not be installed."""
    from .ros2 import ros2 as run

    run(robot or [], domain, namespace, router, not humble, allow_motion, mesh, as_json=json)


@app.command()
def drill(
    robot: Kind,
    port: Annotated[str | None, typer.Option(help="Serial port or address of a real robot.")] = None,
    twin: Annotated[bool, typer.Option("--twin", help="Drill the robot's twin.")] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask for consent.")] = False,
    option: Annotated[
        list[str] | None, typer.Option(metavar="KEY=VALUE", help="A keyword of Robot(). Can be repeated.")
    ] = None,
    id_: Id = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Write a report without personal data, which you may send to the project."
        ),
    ] = None,
    dialogue: Dialogue = False,
    json: Json = False,
) -> None:
    """Test on your robot that each kind of fault stops it, and keep a certificate."""
    from .drill import run as drill_robot

    options = [*(option or []), *([] if id_ is None else [f"id={json_of(id_)}"])]
    raise typer.Exit(drill_robot(robot, port, twin, yes, options, json or dialogue, report, dialogue))


@app.command()
def matrix(
    drivers: Annotated[
        str | None, typer.Option(help="Robots, separated by commas. Default: one of each driver.")
    ] = None,
    repeats: Annotated[int, typer.Option(min=1, help="Trials per cell.")] = 1,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="Write the page to this file. Columns of other robots are kept."),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Number of robots that are broken at the same time.")] = 1,
    resume: Annotated[
        Path | None, typer.Option(help="Save each trial in this file, and skip those that it has.")
    ] = None,
    pairs: Annotated[bool, typer.Option(help="Break two processes, one shortly after the other.")] = False,
    victims: Annotated[
        str | None, typer.Option(help="Break only these processes, separated by commas. Default: all.")
    ] = None,
    json: Json = False,
) -> None:
    """Break each process and connection of simulated robots in turn, and measure how they stop."""
    from .matrix import run as measure

    raise typer.Exit(measure(drivers, repeats, out, json, jobs, resume, pairs, victims))


def main() -> None:
    """Run the console script."""
    sys.exit(run(sys.argv[1:]))


def run(arguments: Sequence[str]) -> int:
    """Run one command and return its exit code.

    A failure is one line on stderr and, with --json, also an object with ``error`` on stdout.

    Returns:
        0: The command succeeded.
        1: It ran, but without success (a robot is not confirmed safe, a recording differs).
        2: It could not run.
        130: It was interrupted.
    """
    try:
        return _run(arguments)
    except Ended as ended:
        if "--json" in arguments:
            print(json_of({"error": str(ended)}), flush=True)
        print(f"strands-actors: {ended}", file=sys.stderr)
        return USAGE


class Ended(Exception):
    """A command could not run. The message is one line that explains why."""


def _run(arguments: Sequence[str]) -> int:
    try:
        command = typer.main.get_command(app)
        command_line = spelled(arguments, getattr(command, "commands", {}))
        code = command(command_line or ["--help"], prog_name="strands-actors", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except BaseExceptionGroup as group:
        return _ended(group)
    except (Problem, MissingExtra, OSError) as problem:
        raise Ended(_line(str(problem))) from problem
    except Exception as error:
        usage = getattr(error, "format_message", None)  # Errors of typer have this method in all versions of typer.
        if usage is None:
            raise
        raise Ended(_line(usage())) from error
    return code if isinstance(code, int) else 0


def _ended(error: BaseException) -> int:
    """Return the exit code for the first exception of a group. If there is no exit code for it, raise the
    group."""
    first = error
    while isinstance(first, BaseExceptionGroup):
        first = first.exceptions[0]
    match first:
        case KeyboardInterrupt():
            return INTERRUPTED
        case BrokenPipeError():  # The program that reads our output, such as ``head``, has ended.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        case Problem() | RecordingError() | OSError():
            raise Ended(_line(str(first))) from error
    raise error


def _line(text: str) -> str:
    """Return a message as one line. Replace calls of Python functions by commands for the terminal."""
    return " ".join(text.split()).replace("strands_actors.list_robots()", "`strands-actors list`")
