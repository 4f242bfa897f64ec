"""One point of the scaling study, measured in a process of its own on one thread."""

import json
import os
import subprocess
import sys
from typing import Any

from pipeline.errors import SolveError
from pipeline.studies.scaling.rival import import_task
from pipeline.system.child import make_command
from pipeline.system.threads import make_thread_environment


def measure_in_process(task: str, settings: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a task "module:function"; raises SolveError with the last line of the process's errors."""
    command = make_command(f"from {__name__} import write_row; write_row()", task, json.dumps(settings))
    environment = os.environ | make_thread_environment(1)
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"the process ended with {done.returncode}"]
        raise SolveError(lines[-1])
    row: dict[str, Any] = json.loads(done.stdout)
    return row


def write_row() -> None:
    """Write the row of the task and settings on the command line to standard output, as JSON."""
    task, settings = sys.argv[1:]
    sys.stdout.write(json.dumps(import_task(task)(json.loads(settings))) + "\n")
