"""A tuned `PID` as source code: C, MATLAB or Python."""

import math
from collections.abc import Mapping
from pathlib import Path
from string import Template

from zoac.controllers.pid import PID
from zoac.core.errors import ConfigError, suggest


def export_pid(pid: PID, parameters: Mapping[str, float], path: str | Path) -> Path:
    """Write the controller in the language that the suffix names; return the path.

    Args:
        pid: Its structure: sample time, limits, weights, anti-windup.
        parameters: Its gains, in the form of `pid`.
        path: `.h` (C to include: a state struct, `pid_init` and `pid_step`, without dependencies),
            `.m` (MATLAB's `pid(Kp, Ki, Kd, Tf, Ts)`), `.py` (a function `step(r, y)`; the file
            imports zoac and NumPy).

    Raises:
        ConfigError: If the suffix is unknown, a gain is misspelt or not finite, or the file cannot
            be written.
    """
    path = writable(path)
    for name in ("Ti", "N"):
        if pid.form == "standard" and parameters.get(name) == 0:
            raise ConfigError(
                f"{name}=0: expected a number above 0; without that part leave it out"
            )
    gains = dict(zip(("Kp", "Ki", "Kd", "Tf"), map(float, pid.gains(parameters)), strict=True))
    for name, value in gains.items():
        if not math.isfinite(value):
            raise ConfigError(f"{name}={value}: only finite gains can be exported")
    code = WRITERS[path.suffix](pid, gains)
    try:
        path.write_text(code, encoding="utf-8")
    except OSError as error:
        raise _unwritable(path, str(error.strerror)) from None
    return path


def writable(path: str | Path) -> Path:
    """Return the path of an export, seen to be one that can be written.

    Raises:
        ConfigError: If its suffix is unknown or its folder is missing.
    """
    if not isinstance(path, str | Path):
        raise ConfigError(f"export={path!r}: expected a file, such as 'pid.h'")
    path = Path(path).expanduser()
    if path.suffix not in WRITERS:
        raise ConfigError(f"export to {path.name!r}: {suggest(path.suffix, WRITERS)}")
    if not path.parent.is_dir():
        raise _unwritable(path, "No such folder")
    return path


def _unwritable(path: Path, reason: str) -> ConfigError:
    return ConfigError(
        f"export to {str(path)!r}: {reason}; choose a folder that is there and can be written to"
    )


def _number(value: float) -> str:
    """Return a C literal that reads back as the same double."""
    if math.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(float(value))


CODE = """\
/* A PID controller: call pid_init once, then pid_step every PID_TS seconds. */
#include <math.h>

#define PID_TS ($ts) /* sample time [s] */
#define PID_KP ($Kp)
#define PID_KI ($Ki) /* [1/s] */
#define PID_KD ($Kd) /* [s] */
#define PID_TF ($Tf) /* filter [s] */
#define PID_B ($b) /* weight of the set-point, proportional part */
#define PID_C ($c) /* weight of the set-point, derivative part */
#define PID_LOW ($low) /* smallest output */
#define PID_HIGH ($high) /* largest output */
#define PID_MAX_MOVE ($move) /* largest change a step */

typedef struct { double integral, derivative, y, r, u; int begun; } pid_state;

static void pid_init(pid_state *s)
{
    s->integral = s->derivative = s->y = s->r = 0.0;
    s->u = $first;
    s->begun = 0;
}

static double pid_step(pid_state *s, double r, double y)
{
    double p, v, u, step;
    if (!s->begun) { s->y = y; s->r = r; }
    p = PID_KP * (PID_B * r - y);
    s->derivative = (PID_TF * s->derivative
                     + PID_KD * (PID_C * (r - s->r) - (y - s->y)))
                    / (PID_TF + PID_TS);
    if ($bumpless && !s->begun) s->integral = s->u - p;
    v = p + s->integral + s->derivative;
    u = v;
    if ($bumpless || s->begun) {
        if (u > s->u + PID_MAX_MOVE) u = s->u + PID_MAX_MOVE;
        if (u < s->u - PID_MAX_MOVE) u = s->u - PID_MAX_MOVE;
    }
    if (u > PID_HIGH) u = PID_HIGH;
    if (u < PID_LOW) u = PID_LOW;
    step = PID_KI * PID_TS * (r - y);
$windup    s->integral = s->integral + step;
    s->y = y; s->r = r; s->u = u; s->begun = 1;
    return u;
}
"""


def _c(pid: PID, gains: Mapping[str, float]) -> str:
    """Return the state struct, `pid_init` and `pid_step` in C."""
    windup, time = "", float(pid.tracking_time_of(gains["Kp"], gains["Ki"], gains["Kd"]))
    if pid.anti_windup == "clamping":
        windup = "    if ((v - u) * step > 0.0) step = 0.0; /* clamping */\n"
    elif pid.anti_windup == "back_calculation" and math.isfinite(time):
        factor = _number(pid.sample_time / time)
        windup = f"    step = step + {factor} * (u - v); /* back-calculation */\n"
    low, high = pid.output_limits
    move = pid.rate_limit * pid.sample_time
    numbers = {"ts": pid.sample_time, "b": pid.b, "c": pid.c, "low": low, "high": high,
               "move": move, "first": pid.initial_output or 0.0, **gains}  # fmt: skip
    return Template(CODE).substitute(
        {name: _number(value) for name, value in numbers.items()},
        windup=windup,
        bumpless="0" if pid.initial_output is None else "1",
    )


def _matlab(pid: PID, gains: Mapping[str, float]) -> str:
    values = ", ".join(repr(gains[name]) for name in ("Kp", "Ki", "Kd", "Tf"))
    formula = "'IFormula', 'ForwardEuler', 'DFormula', 'BackwardEuler'"
    return (
        "% Limits, set-point weights and anti-windup are not part of a pid object.\n"
        f"C = pid({values}, {pid.sample_time!r}, {formula});\n"
    )


def _python(pid: PID, gains: Mapping[str, float]) -> str:
    options = {
        name: getattr(pid, name)
        for name in ("sample_time", "b", "c", "output_limits", "rate_limit", "anti_windup",
                     "tracking_time", "initial_output")
    }  # fmt: skip
    arguments = ",\n    ".join(f"{name}={_literal(value)}" for name, value in options.items())
    values = tuple(gains.values())
    return (
        "import math\n\nimport numpy as np\n\nfrom zoac.controllers.pid import PID\n\n"
        f"pid = PID(\n    {arguments},\n)\ngains = {values!r}\nmemory = pid.init(1)\n\n\n"
        "def step(r, y):\n    global memory\n"
        "    u, memory = pid.step(gains, np.array([y]), np.array([r]), memory)\n"
        "    return float(u[0])\n"
    )


def _literal(value: object) -> str:
    return repr(value).replace("inf", "math.inf")


WRITERS = {".h": _c, ".m": _matlab, ".py": _python}
"""By suffix."""
