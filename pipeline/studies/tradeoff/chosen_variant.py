"""The choice of a trade-off study written into its case file, as the variant "adequate"."""

import json
import re
import tomllib
from typing import Any

from pipeline.case import load_case
from pipeline.errors import CaseError
from pipeline.formats.atomic import replace_file
from pipeline.studies.tradeoff.levels import make_mesh_keys
from pipeline.studies.tradeoff.settings import Plan, Setting, make_method_keys
from pipeline.system.times import count_intervals

NAME = "adequate"
_MARK = "# The choice of `pipeline study tradeoff`"
# from the mark to the next empty line or the end
_BLOCK = re.compile(rf"\n*^{re.escape(_MARK)}.*?(?=\n\n|\Z)", re.MULTILINE | re.DOTALL)


def write_chosen_variant(plan: Plan, setting: Setting, why: str) -> None:
    """Append the setting to the case's file as [variants.adequate], in place of an earlier choice; the rest is kept.

    The frames are those of the case if dt divides their interval. Raises CaseError if the file has another variant of
    this name or an inline table of variants, OutputError if it cannot be written.
    """
    path = plan.case.path
    text = _BLOCK.sub("", path.read_text(encoding="utf-8")).rstrip("\n")
    variants = tomllib.loads(text).get("variants", {})
    if NAME in variants:
        raise CaseError(f"{path}: variants.{NAME}: exists already; rename it or remove it")
    keys = [f'"{key}" = {_format_inline(value)}' for key, value in _make_overrides(plan, setting).items()]
    lines = [_MARK, f"# {why}", f"[variants.{NAME}]", *keys]
    if not variants:  # the only variant of a case without variants
        lines[2:2] = ["[variants.default]"]
    with replace_file(path) as hidden:
        hidden.write_text("\n".join([text, "", *lines, ""]), encoding="utf-8")
        try:
            load_case(hidden)
        except CaseError as error:
            line = f"{NAME} = {{{', '.join(keys)}}}"
            raise CaseError(f"{path}: variants: cannot be appended to; add {line} yourself") from error


def _format_inline(value: Any) -> str:
    """Return a TOML value on one line."""
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {_format_inline(item)}' for key, item in value.items())}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_format_inline, value))}]"
    return json.dumps(value)  # strings and numbers are the same in TOML


def _make_overrides(plan: Plan, setting: Setting) -> dict[str, Any]:
    schedule = plan.case.schedule
    interval = schedule.dt * schedule.steps_per_frame
    steps = count_intervals(interval, setting.dt)
    if steps is not None:
        frames = {"dt": interval / steps, "steps_per_frame": steps, "frames": schedule.frames}
    else:
        frames = {
            "dt": setting.dt,
            "steps_per_frame": 1,
            "frames": max(1, int(interval * schedule.frames / setting.dt)),
        }
    return make_method_keys(plan, setting) | make_mesh_keys(plan.case, setting.level) | {"schedule": frames}
