"""A PID controller that one would ship: filter, set-point weights, limits, anti-windup.

In the parallel form, with backward differences for the derivative and forward ones for the
integral (Åström and Hägglund, Advanced PID Control, chapter 13), a step of T_s seconds is

    P   = Kp (b r - y)
    D   = Tf / (Tf + T_s) D' + Kd / (Tf + T_s) ((c r - y) - (c r' - y'))
    v   = P + I + D
    u   = v, limited in rate and then in size
    I  <- I + Ki T_s (r - y) + what anti-windup adds

where a prime marks the value of the step before. The standard form K (1 + 1 / (Ti s) + Td s /
(Td / N s + 1)) is the parallel one with Kp = K, Ki = K / Ti, Kd = K Td, Tf = Td / N.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, get_args

import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.core.types import is_number

Form = Literal["parallel", "standard"]
AntiWindup = Literal["back_calculation", "clamping", "none"]

NAMES = {"parallel": ("Kp", "Ki", "Kd", "Tf"), "standard": ("K", "Ti", "Td", "N")}
"""Parameters of each form; those in the same place stand for each other."""


@lru_cache(maxsize=64)  # every step asks
def _check_names(form: Form, given: tuple[str, ...]) -> None:
    """See that names are gains, or at least not meant as gains.

    Raises:
        ConfigError: If a name differs from a gain in its spelling only, is a gain of the other
            form, or none is a gain.
    """
    names = NAMES[form]
    (other,) = (form for form in NAMES if NAMES[form] is not names)
    absent = [name for name in names if name not in given]
    spelt = {name.lower(): name for name in absent}
    # Others of the other form, such as Td or Tf, may well be meant for something else.
    of_other = [b for a, b in zip(names[:2], NAMES[other], strict=False) if a in absent]
    for name in given:
        if name in names:
            continue
        if name in of_other:
            raise ConfigError(
                f"{name!r} is a gain of the {other} form; expected {', '.join(names)}, or give "
                f"PID(form={other!r})"
            )
        meant = spelt.get(name.replace("_", "").lower())
        if meant or len(absent) == len(names):
            hint = suggest(meant or name, names)
            raise ConfigError(f"unknown gain {name!r} of the {form} form; {hint}")


@dataclass(frozen=True, kw_only=True)
class PID:
    """A PID as a batched controller: what it remembers is in its memory, not in the object.

    Args:
        sample_time: T_s [s].
        y: Position of the measured output in the observation.
        r: Position of the reference in the observation, or None with `setpoint`.
        setpoint: Constant reference, where the observation has none.
        form: Names of the parameters: "parallel" `Kp, Ki, Kd, Tf` or "standard" `K, Ti, Td, N`.
            Those that are not given are 0 (`Ti` and `N`: infinite).
        b: Weight of the reference in the proportional part.
        c: Weight of the reference in the derivative part.
        output_limits: Smallest and largest output.
        rate_limit: Largest change of the output per second; without `initial_output` from the
            second step on, because the output before the first is then not known.
        anti_windup: "clamping" holds the integral while the output is limited and the error would
            drive it further; "back_calculation" leads it back with the time constant
            `tracking_time`.
        tracking_time: Of back-calculation [s]; None: sqrt(Kd / Ki), or Kp / Ki without a
            derivative part.
        initial_output: Output before the first step, from which it starts without a bump; None: the
            integral starts at 0.

    Raises:
        ConfigError: If an argument is out of its range.
    """

    sample_time: float
    y: int = 0
    r: int | None = None
    setpoint: float = 0.0
    form: Form = "parallel"
    b: float = 1.0
    c: float = 0.0
    output_limits: tuple[float, float] = (-math.inf, math.inf)
    rate_limit: float = math.inf
    anti_windup: AntiWindup = "clamping"
    tracking_time: float | None = None
    initial_output: float | None = None

    def __post_init__(self) -> None:
        ts = self.sample_time
        if not (is_number(ts) and math.isfinite(ts) and ts > 0):
            raise ConfigError(f"sample_time={ts!r}: expected seconds above 0")
        low, high = self.output_limits
        if not low < high:
            raise ConfigError(f"output_limits={self.output_limits}: expected (low, high)")
        if not self.rate_limit > 0:
            raise ConfigError(f"rate_limit={self.rate_limit}: expected a number above 0")
        for name, value, known in (
            ("form", self.form, get_args(Form)),
            ("anti_windup", self.anti_windup, get_args(AntiWindup)),
        ):
            if value not in known:
                raise ConfigError(f"{name}={value!r}: {suggest(str(value), known)}")
        if self.tracking_time is not None and not self.tracking_time > 0:
            raise ConfigError(f"tracking_time={self.tracking_time}: expected seconds above 0")

    def init(self, n: int) -> dict[str, np.ndarray]:
        """Return the memory of `n` controllers before their first step."""
        return {name: np.zeros(n) for name in ("integral", "derivative", "y", "r", "u", "begun")}

    def act(
        self, params: Mapping[str, np.ndarray], obs: np.ndarray, memory: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Return outputs (n, 1) and the next memory; see `Controller.act`."""
        y = obs[:, self.y]
        r = np.full_like(y, self.setpoint) if self.r is None else obs[:, self.r]
        u, memory = self.step(self.gains(params), y, r, memory)
        return u[:, None], memory, {}

    def gains(self, params: Mapping[str, Any]) -> tuple[Any, Any, Any, Any]:
        """Return Kp, Ki, Kd and Tf from parameters in this controller's form.

        Parameters of other names are left to the controller that this one is a part of.

        Raises:
            ConfigError: If a gain is misspelt or of the other form, or none is given.
        """
        _check_names(self.form, tuple(params))
        get = params.get
        if self.form == "parallel":
            return get("Kp", 0.0), get("Ki", 0.0), get("Kd", 0.0), get("Tf", 0.0)
        k, ti, td, n = get("K", 0.0), get("Ti", math.inf), get("Td", 0.0), get("N", math.inf)
        return k, k / ti, k * td, td / n

    def step(
        self,
        gains: tuple[Any, Any, Any, Any],
        y: np.ndarray,
        r: np.ndarray,
        memory: Mapping[str, np.ndarray],
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return outputs (n,) and the next memory.

        Args:
            gains: Kp, Ki, Kd and Tf, numbers or (n,).
            y: Measured outputs (n,).
            r: References (n,).
            memory: From `init` or the step before.
        """
        kp, ki, kd, tf = gains
        begun = memory["begun"] > 0
        last = memory["u"]
        y_before, r_before = np.where(begun, memory["y"], y), np.where(begun, memory["r"], r)
        proportional = kp * (self.b * r - y)
        change = self.c * (r - r_before) - (y - y_before)
        derivative = (tf * memory["derivative"] + kd * change) / (tf + self.sample_time)
        integral = memory["integral"]
        if self.initial_output is not None:
            integral = np.where(begun, integral, self.initial_output - proportional)
            last = np.where(begun, last, self.initial_output)
        v = proportional + integral + derivative
        moves = begun if self.initial_output is None else np.ones_like(begun)
        most = self.rate_limit * self.sample_time
        u = np.where(moves, np.clip(v, last - most, last + most), v)
        u = np.clip(u, *self.output_limits)
        error = r - y
        step = ki * self.sample_time * error
        if self.anti_windup == "clamping":
            step = np.where((v - u) * step > 0.0, 0.0, step)
        elif self.anti_windup == "back_calculation":
            step = step + self.sample_time / self.tracking_time_of(kp, ki, kd) * (u - v)
        return u, {
            "integral": integral + step,
            "derivative": derivative,
            "y": y,
            "r": r,
            "u": u,
            "begun": np.ones_like(y),
        }

    def tracking_time_of(self, kp: Any, ki: Any, kd: Any) -> Any:
        """Return the time constant [s] of back-calculation for these gains."""
        if self.tracking_time is not None:
            return self.tracking_time
        with np.errstate(divide="ignore", invalid="ignore"):
            time = np.where(np.asarray(kd * ki) > 0, np.sqrt(np.divide(kd, ki)), np.divide(kp, ki))
        # Without an integral part there is nothing to lead back.
        return np.where(np.isfinite(time) & (time > 0), np.maximum(time, self.sample_time), np.inf)
