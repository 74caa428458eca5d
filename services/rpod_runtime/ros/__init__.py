"""A service as a node of ROS 2: its services, parameters and log lines, in the form of rmw_zenoh.

Nothing here is needed by the facility itself, which uses the JSON queries of the control plane.
"""

from rpod_runtime.ros.forms import RESET_SERVICE, Form, trigger
from rpod_runtime.ros.graph import RosGraph

__all__ = ["RESET_SERVICE", "Form", "RosGraph", "trigger"]
