"""The target at the angles that its joints have at a time."""

from rpod_schemas.config.emulator import EmulatorConfig
from rpod_schemas.errors import ConfigurationError
from rpod_target import Target, shown


class MovingJoints:
    """Shows a target with its joints as the configuration moves them.

    Raises:
        ConfigurationError: the target has no joint of a configured name.
    """

    def __init__(self, config: EmulatorConfig, target: Target) -> None:
        known = [joint.name for joint in target.joints]
        for name in config.joints:
            if name not in known:
                reason = f"{target.name} has no such joint; its file declares {', '.join(known) or 'none'}"
                raise ConfigurationError(config.instance, f"joints.{name}", reason)
        self._motion, self._target = config.joints, target
        self.turn = any(motion.rate_deg_s for motion in config.joints.values())
        """Whether any joint turns."""

    def at(self, time_s: float) -> Target:
        """Return the target at a time from the epoch; the joints do not move during a frame."""
        return shown(self._target, {name: motion.angle_rad(time_s) for name, motion in self._motion.items()})
