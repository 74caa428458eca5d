"""The firewall's rule for a secure bus, loaded into a network namespace of its own; needs ``nft``."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

RULES = Path(__file__).parents[2] / "deploy" / "firewall" / "rpod.nft"
BURST, PER_SECOND = 20, 2
WITHIN = ["unshare", "--map-root-user", "--net"]
ATTEMPTS = """
import json, socket, subprocess, time
subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
subprocess.run(["nft", "-f", {rules!r}], check=True)
with socket.create_server(("127.0.0.1", 7447), backlog=1024), socket.create_server(("127.0.0.1", 7448)):
    def opened(source, count, port=7447):
        found = 0
        for _ in range(count):
            try:
                socket.create_connection(("127.0.0.1", port), 5.0, (source, 0)).close()
                found += 1
            except ConnectionRefusedError:
                pass
        return found
    begin = time.monotonic()
    flood = opened("127.0.0.2", 200)
    print(json.dumps(dict(
        flood=flood, seconds=time.monotonic() - begin, another=opened("127.0.0.3", 10),
        own=opened("127.0.0.1", 200), other_port=opened("127.0.0.2", 1, 7448),
    )))
"""


def may_have_namespaces() -> bool:
    if shutil.which("nft") is None or shutil.which("unshare") is None or shutil.which("ip") is None:
        return False
    tried = subprocess.run([*WITHIN, "nft", "list", "ruleset"], capture_output=True, check=False)
    return tried.returncode == 0


@pytest.mark.skipif(not may_have_namespaces(), reason="needs nft, ip, and a network namespace of one's own")
def test_a_flood_of_connections_from_one_address_is_refused_and_all_others_get_in():
    command = [*WITHIN, sys.executable, "-c", ATTEMPTS.format(rules=str(RULES))]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert BURST <= said["flood"] <= BURST + PER_SECOND * said["seconds"] + 1
    assert (said["another"], said["own"], said["other_port"]) == (10, 200, 1)
