from threading import Event
from types import SimpleNamespace

import pytest

from rpod_schemas.config.base import check
from rpod_schemas.config.facility.view import ViewConfig
from rpod_schemas.errors import ConfigurationError
from rpod_view.daemon import _target
from rpod_view.viewer.viewer import has_display, open_viewer


def test_a_view_stays_on_this_machine_unless_told_otherwise():
    config = ViewConfig(port=9876, web_port=9090)
    assert str(config.bind) == "127.0.0.1"
    assert config.data_url == "rerun+http://127.0.0.1:9876/proxy"
    assert config.page_url == "http://127.0.0.1:9090/?url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A9876%2Fproxy"


@pytest.mark.parametrize(
    ("bind", "host"),
    [("192.0.2.7", "192.0.2.7"), ("0.0.0.0", "127.0.0.1"), ("::", "[::1]"), ("::1", "[::1]")],  # noqa: S104
)
def test_data_go_to_where_the_viewer_listens(bind, host):
    config = check(ViewConfig, {"bind": bind, "port": 1, "token_file": "token"}, source="test")
    assert config.data_url == f"rerun+http://{host}:1/proxy"


@pytest.mark.parametrize(
    "document", [{"rate_hz": 10.5}, {"rate_hz": 0}, {"bind": "localhost:1"}, {"viewer": "paper"}]
)
def test_what_a_view_does_not_do_is_refused(document):
    with pytest.raises(ConfigurationError, match=next(iter(document))):
        check(ViewConfig, document, source="test")


def test_a_recording_needs_the_ending_by_which_a_viewer_opens_it():
    with pytest.raises(ConfigurationError, match=r"save: is 'x\.txt'; .* take 'x\.rrd'$"):
        check(ViewConfig, {"save": "x.txt"}, source="test")


def test_a_recording_is_written_and_a_window_is_shown(tmp_path):
    with open_viewer(ViewConfig(save=tmp_path / "run.rrd"), Event()) as viewer:
        assert (viewer.how, viewer.where) == ("written to", str(tmp_path / "run.rrd"))


def test_its_configuration_survives_its_file():
    config = ViewConfig(target="mockup", bind="::1", save="run.rrd")
    assert ViewConfig.model_validate_json(config.model_dump_json()) == config


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_a_window_needs_a_display(monkeypatch, name):
    monkeypatch.setattr("sys.platform", "linux")
    for each in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(each, raising=False)
    assert not has_display()
    monkeypatch.setenv(name, ":0")
    assert has_display()


@pytest.mark.parametrize("named", [None, 7, {"a": 1}, ["mockup"]])
def test_a_target_that_is_no_name_is_not_shown(named):
    status = SimpleNamespace(configuration={"target": named})
    assert _target(SimpleNamespace(ask_all=lambda: [status]), None) is None
