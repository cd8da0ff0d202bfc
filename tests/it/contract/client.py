"""openapi.yaml as generators of clients see it: a validator accepts it, a generated client imports
every operation and makes real calls. Arguments: openapi.yaml, the address of a service, a key of an
admin, an empty folder."""

import importlib
import pkgutil
import subprocess
import sys
from pathlib import Path

from openapi_spec_validator import validate
from openapi_spec_validator.readers import read_from_filename

description, url, key, folder = Path(sys.argv[1]), sys.argv[2], sys.argv[3], Path(sys.argv[4])

document, _ = read_from_filename(str(description))
validate(document)

config = Path(__file__).with_name("client.yaml")
subprocess.run(
    [str(Path(sys.executable).with_name("openapi-python-client")), "generate", "--meta", "none",
     "--path", str(description), "--config", str(config), "--output-path", str(folder / "palpate_api"),
     "--fail-on-warning"],
    check=True,
)
sys.path.insert(0, str(folder))
import palpate_api.api  # noqa: E402
from palpate_api import AuthenticatedClient, Client  # noqa: E402

modules = {
    module.name.rsplit(".", 1)[1]: importlib.import_module(module.name)
    for module in pkgutil.walk_packages(palpate_api.api.__path__, "palpate_api.api.")
    if not module.ispkg
}
operations = {
    operation["operationId"]
    for item in document["paths"].values()
    for operation in item.values()
    if isinstance(operation, dict) and "operationId" in operation
}
assert set(modules) == operations, set(modules) ^ operations

client = AuthenticatedClient(base_url=url, token=key)


def call(operation, status, **arguments):
    """Calls an operation and returns its typed answer."""
    answer = modules[operation].sync_detailed(client=client, **arguments)
    assert answer.status_code == status, (operation, answer.status_code, answer.content)
    if status != 204:
        assert answer.parsed is not None, (operation, answer.content[:500])
    return answer.parsed


status = call("status", 200)
assert status.rig.name and status.service.pid > 0
runs = call("list_runs", 200)
run = runs.items[0]
assert call("run", 200, run=run.uid).scan_id == run.scan_id
assert call("run_summary", 200, run=str(run.scan_id)).trials_stored > 0
page = call("list_trials", 200, limit=3)
assert [trial.tips > 0 for trial in page.items] == [True] * 3
trial = call("trial", 200, trial=page.items[0].trial_id)
assert trial.trial_id == page.items[0].trial_id and len(trial.voltages_v) == 784
assert len(call("events", 200, limit=2).items) <= 2
assert call("list_datasets", 200).definitions
assert call("queue", 200).items == []
call("actions", 200, limit=2)
models = importlib.import_module("palpate_api.models")
made = call("create_key", 201, body=models.KeyRequest(name="generated", role=models.Role.VIEWER))
assert made.secret.startswith("palpate_")
call("revoke_key", 204, id=made.key.id)
lock = call("take_lock", 200, body=models.LockRequest(note="a generated client"))
assert lock.note == "a generated client"
call("clear_lock", 204)
assert call("run", 404, run="999999").detail == "no run 999999"
assert call("list_runs", 400, limit=1001).errors
refused = modules["status"].sync_detailed(client=Client(base_url=url, headers={"Authorization": "Basic x"}))
assert refused.status_code == 401 and refused.parsed.status == 401
print(f"{len(operations)} operations imported, 16 called")
