"""The files that start a cluster are what their programs take, as far as that can be told without them."""

import re
import subprocess
import sys
from pathlib import Path

import kubernetes_validate
import pytest
import yaml

from rpod import __version__

CLUSTER = Path(__file__).parents[2] / "deploy" / "cluster"
MANIFESTS = [
    pytest.param(document, id=f"{file.stem}-{document['kind']}")
    for file in sorted((CLUSTER / "kubernetes").glob("*.yaml"))
    for document in yaml.safe_load_all(file.read_text("utf-8"))
]
COMPOSE = yaml.safe_load((CLUSTER / "compose.yaml").read_text("utf-8"))


def containers():
    """Return image and command of everything that is started."""
    for manifest in (parameter.values[0] for parameter in MANIFESTS):
        pod = manifest.get("spec", {}).get("template", {}).get("spec", {})
        for container in pod.get("containers", ()):
            yield container["image"], [*container["command"], *container.get("args", ())]
    for service in COMPOSE["services"].values():
        yield service["image"], service.get("command", ["rpod"])


@pytest.mark.parametrize("manifest", MANIFESTS)
def test_a_manifest_keeps_to_the_schema_of_kubernetes(manifest):
    kubernetes_validate.validate(manifest, "1.34", strict=True)


def test_a_manifest_with_an_unknown_field_is_found():
    wrong = MANIFESTS[0].values[0] | {"sepc": {}}
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, "1.34", strict=True)


def test_names_that_refer_to_one_another_are_there():
    manifests = [parameter.values[0] for parameter in MANIFESTS]
    named = {(manifest["kind"], manifest["metadata"]["name"]) for manifest in manifests}
    text = "".join(file.read_text("utf-8") for file in (CLUSTER / "kubernetes").glob("*.yaml"))
    for host in re.findall(r"tcp://([\w-]+):8786", text):
        assert ("Service", host) in named
    for claim in re.findall(r"claimName: ([\w-]+)", text):
        assert ("PersistentVolumeClaim", claim) in named
    for manifest in manifests:
        if manifest["kind"] == "Deployment":
            selected, labels = manifest["spec"]["selector"], manifest["spec"]["template"]["metadata"]
            assert selected["matchLabels"].items() <= labels["labels"].items()


def test_the_services_of_compose_depend_on_one_another_and_share_the_folder():
    services = COMPOSE["services"]
    for service in services.values():
        assert set(service.get("depends_on", ())) <= set(services)
        for volume in service.get("volumes", ()):
            assert volume.partition(":")[0] in COMPOSE["volumes"]
    assert services["worker"]["volumes"] == services["client"]["volumes"]


def test_every_image_is_of_this_version_and_every_command_is_taken_by_its_program():
    options: dict[str, str] = {}
    for image, command in containers():
        assert image == f"rpod-campaign:{__version__}"
        if command[0] != "dask":
            continue
        program = command[1]
        if program not in options:
            done = subprocess.run(
                [sys.executable, "-m", f"distributed.cli.dask_{program}", "--help"],
                capture_output=True, text=True, timeout=60.0, check=True,
            )  # fmt: skip
            options[program] = done.stdout
        for option in (word for word in command if word.startswith("--")):
            assert re.search(rf"{option}\b", options[program]), (program, option)


def test_the_script_for_slurm_is_a_script():
    subprocess.run(["bash", "-n", str(CLUSTER / "campaign.slurm")], check=True, timeout=10.0)
    assert "#SBATCH --ntasks=" in (CLUSTER / "campaign.slurm").read_text("utf-8")
