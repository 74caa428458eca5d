"""The chaser's commanded acceleration as an input of the estimator, which the model of motion uses."""

from rpod_estimator.inputs.stamped import StampedInput
from rpod_pose.navigation.dynamics.command_track import VALID_S, CommandTrack
from rpod_runtime import Node, Received
from rpod_schemas.config.estimator import EstimatorConfig
from rpod_schemas.messages import read_command
from rpod_schemas.topics import COMMAND


class CommandInput(StampedInput[CommandTrack]):
    """Receives ``guidance/command``, and waits until a frame's stamp is covered.

    Args:
        node: the estimator's node.
        config: its configuration.
        track: where commands go; None if they are not used.
    """

    name, lack = "command", "unknown"
    late_s = 0.02
    alarm = (
        "{topics} has no command "
        f"of the last {VALID_S:g} s before the frame: the chaser's acceleration is unknown, and a track "
        "without measurements is lost sooner; send commands at 1 Hz or faster, zeros too"
    )
    again = f"{COMMAND.name}: in order again"

    def __init__(self, node: Node, config: EstimatorConfig, track: CommandTrack | None) -> None:
        super().__init__(node, {} if track is None else {COMMAND: track}, in_lockstep=config.in_lockstep)

    def use(self, track: CommandTrack, received: Received) -> bool:
        """Add a command and return True; return False if it is not newer than all before."""
        return track.take(read_command(received.decode()))

    def is_known(self, track: CommandTrack, stamp_ns: int) -> bool:
        """Return whether a command holds at a stamp."""
        return track.is_known(stamp_ns)
