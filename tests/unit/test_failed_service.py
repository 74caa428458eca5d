"""What a run says of a service that cannot do its work."""

import pytest

from rpod.errors import FailedServiceError


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (
            "2026-01-01 00:00:00,000 INFO    logger: started\n"
            "2026-01-01 00:00:01,000 ERROR   logger: cannot write a.mcap: No space left on device\n"
            "2026-01-01 00:00:02,000 ERROR   logger: lost 12 messages\n",
            "service logger cannot do its work: cannot write a.mcap: No space left on device; see ",
        ),
        ("", "service logger cannot do its work: it does not say why; see "),
    ],
)
def test_the_first_error_of_its_log_is_told(tmp_path, lines, told):
    log = tmp_path / "logger.log"
    log.write_text(lines, "utf-8")
    assert str(FailedServiceError("logger", log)) == f"{told}{log}"
