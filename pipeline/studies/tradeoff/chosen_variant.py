"""The choice of a trade-off study written into its case file, as the variant "adequate"."""

import json
import re
import tomllib
from typing import Any

from pipeline.case import load_case
from pipeline.errors import CaseError
from pipeline.formats.atomic import replace_file
from pipeline.studies.tradeoff.settings import Plan, Setting, make_mesh_keys, make_method_keys

NAME = "adequate"
_MARK = "# The choice of `pipeline study tradeoff`"
# our own block: from the mark to the next empty line or the end
_BLOCK = re.compile(rf"\n*^{re.escape(_MARK)}.*?(?=\n\n|\Z)", re.MULTILINE | re.DOTALL)


def write_chosen_variant(plan: Plan, setting: Setting, why: str) -> None:
    """Append the setting to the case's file as [variants.adequate]; what stood there is kept, an earlier choice is not.

    The frames are those of the case where dt divides their interval. Raises CaseError where the file has such a
    variant of its own or keeps its variants in an inline table, OutputError where it cannot be written.
    """
    path = plan.case.path
    text = path.read_text(encoding="utf-8")
    kept = _BLOCK.sub("", text).rstrip("\n")
    variants = tomllib.loads(kept).get("variants", {})
    if NAME in variants:
        raise CaseError(f"{path}: variants.{NAME}: is there already; rename it or remove it")
    keys = [f'"{key}" = {_format_inline(value)}' for key, value in _make_overrides(plan, setting).items()]
    lines = [_MARK, f"# {why}", f"[variants.{NAME}]", *keys]
    if not variants:  # a case without variants has one, of this name
        lines[2:2] = ["[variants.default]"]
    with replace_file(path) as hidden:
        hidden.write_text("\n".join([kept, "", *lines, ""]), encoding="utf-8")
        try:
            load_case(hidden)
        except CaseError as error:
            line = f"{NAME} = {{{', '.join(keys)}}}"
            raise CaseError(f"{path}: variants: cannot be appended to; add {line} yourself") from error


def _format_inline(value: Any) -> str:
    """Return a TOML value on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {_format_inline(one)}' for key, one in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_format_inline, value))}]"
    return json.dumps(value)  # of a string or a number it is TOML too


def _make_overrides(plan: Plan, setting: Setting) -> dict[str, Any]:
    schedule = plan.case.schedule
    interval = schedule.dt * schedule.steps_per_frame
    steps = round(interval / setting.dt)
    if steps and abs(interval / setting.dt / steps - 1) < 1e-9:
        rhythm = {"dt": interval / steps, "steps_per_frame": steps, "frames": schedule.frames}
    else:
        rhythm = {
            "dt": setting.dt,
            "steps_per_frame": 1,
            "frames": max(1, int(interval * schedule.frames / setting.dt)),
        }
    return make_method_keys(plan, setting) | make_mesh_keys(plan, setting) | {"schedule": rhythm}
