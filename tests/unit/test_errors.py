"""Every error of the project passes from one process to another, with its text and its fields."""

import importlib
import inspect
import pickle
import pkgutil
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from rpod_runtime.delivery.accounting import Jump
from rpod_runtime.delivery.holders import Peer
from rpod_runtime.sensor_data.step_watch import Step
from rpod_schemas.errors import MessageRejectedError, Reason, RpodError
from rpod_schemas.logs import Recovery

ROOT = Path(__file__).parents[2]
PACKAGES = [
    path.name for room in ("schemas", "services", "sim_sensor") for path in (ROOT / room).glob("rpod*")
]
FACTS = {
    "Path": Path("a/b.mcap"),
    "Path | str": Path("a/b.yaml"),
    "str": "said",
    "str | None": None,
    "int | None": 7,
    "int": 7,
    "float": 1.5,
    "bool": True,
    "bool | None": None,
    "list[str]": ["one", "two"],
    "Sequence[str]": ("one", "two"),
    "Mapping[str, str]": {"chaser": "estimate/odometry", "world": "truth/odometry"},
    "object": 3.0,
    "Exception": OSError(28, "No space left on device"),
    "Reason": Reason.LATE,
    "MessageRejectedError": MessageRejectedError(Reason.LATE, "2 s old"),
    "EntryPoint": EntryPoint("mono", "mono_camera:KIND", "rpod.sensors"),
    "Peer": Peer(b"\x01" * 16, "a0"),
    "Jump": Jump("0/pmd/info", b"\x01" * 16, 7, 7 + 2**40),
    "Step": Step(0.05, 0.01, 0.02),
    "Role": "tracking",
    "tuple[str, ...]": ("one", "two"),
    "Recovery": Recovery(
        source="a",
        out="b",
        size_bytes=20,
        unreadable_bytes=12,
        damaged_places=1,
        closed=False,
        messages=0,
        without_definition=0,
        topics={},
    ),
    "Received": type("Received", (), {"topic": type("Topic", (), {"name": "pmd/depth/image_raw"})}),
}
"""A value of each type that errors are made of, by its annotation."""


def modules():
    for name in PACKAGES:
        package = importlib.import_module(name)
        yield package
        for found in pkgutil.walk_packages(package.__path__, f"{name}."):
            if not found.name.endswith("__main__") and ".examples" not in found.name:
                yield importlib.import_module(found.name)


def errors():
    found = {
        kind
        for module in modules()
        for kind in vars(module).values()
        if inspect.isclass(kind) and issubclass(kind, BaseException) and kind.__module__.startswith("rpod")
    }
    return sorted(found, key=lambda kind: (kind.__module__, kind.__name__))


def made(kind):
    own = kind.__init__ is not Exception.__init__
    parameters = list(inspect.signature(kind.__init__).parameters.values())[1:] if own else []
    if [parameter.kind for parameter in parameters] == [inspect.Parameter.VAR_POSITIONAL] or not own:
        return kind("what is wrong")
    facts = {}
    for parameter in parameters:
        annotation = parameter.annotation
        name = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", str(annotation))
        text = str(annotation).replace("pathlib.", "").replace("collections.abc.", "")
        facts[parameter.name] = FACTS["Role" if name == "Literal" else text if text in FACTS else name]
    return kind(**facts)


@pytest.mark.parametrize("kind", errors(), ids=lambda kind: f"{kind.__module__}.{kind.__name__}")
def test_an_error_passes_from_process_to_process_with_text_and_fields(kind):
    assert issubclass(kind, RpodError)
    sent = made(kind)
    sent.add_note("in trial 7")
    got = pickle.loads(pickle.dumps(sent))  # noqa: S301 - our own
    assert type(got) is kind
    assert str(got) == str(sent)
    assert got.args == sent.args
    assert vars(got) == vars(sent)
