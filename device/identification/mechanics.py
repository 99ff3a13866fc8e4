"""Moving mass, Bl, f0 and Qms, from several measurements or with values of the rig's file.

Under voltage drive the resonance's poles solve (s^2 + s w0 / Qms + w0^2) Z + s Bl^2 / m = 0. Z is
the impedance of the coil at rest. An impedance measurement gives only Bl^2 / m (Thiele, Small).
"""

import json
import math
from dataclasses import fields, replace

import numpy as np

from device.identification import acceleration
from device.identification.impedance import MOTIONAL, Impedance
from device.identification.output_error import Estimate, multiply_powers, require
from device.identification.recording import IdentificationError
from device.rig.rig import Rig, Source
from device.units import FloatArray

Values = dict[str, Estimate]  # by parameter, such as "actuator.resonance_hz"


def add_values(rig: Rig, values: Values, words: str, *, assumed: bool = False) -> Rig:
    """Return the rig with these values. words: their source. assumed: whether they are assumed."""
    sources = [source for source in rig.sources if source.parameter not in values]
    found: dict[str, dict[str, float]] = {}
    for parameter, estimate in values.items():
        sources.append(
            Source(parameter, "assumed", words)
            if assumed
            else Source(parameter, "identified", words, estimate.interval)
        )
        stage, name = parameter.split(".")
        found.setdefault(stage, {})[name] = estimate.value
    stages = {name: replace(getattr(rig, name), **new) for name, new in found.items()}
    return replace(rig, **stages, sources=tuple(sources))


def format_rig(rig: Rig) -> str:
    """Return the rig as TOML for `read_rig`, with the known sources of its values."""
    sources = {source.parameter: source for source in rig.sources}
    lines = [f"name = {json.dumps(rig.name)}"]
    for stage, parameters in rig.stages().items():
        lines += ["", f"[{stage}]"]
        for field in fields(parameters):
            plain = getattr(parameters, field.name)
            value, source = _toml(plain), sources.get(f"{stage}.{field.name}")
            if source:
                words = f"{source.kind} = {json.dumps(source.words)}"
                if source.interval:
                    low, high = source.interval
                    words += f", interval = [{_toml(low)}, {_toml(high)}]"
                value = f"{{ value = {value}, {words} }}"
            elif plain == field.default:
                continue
            lines.append(f"{field.name} = {value}")
    return "\n".join(lines) + "\n"


def _toml(value: object) -> str:
    if isinstance(value, str):
        return json.dumps(value)
    return repr(float(value)) if isinstance(value, float) else str(value)


def solve_mechanics(mode: acceleration.Mode, rig: Rig) -> Values:
    """Return f0 and Qms for an open coil, from a `Mode` of acceleration per coil voltage.

    The intervals assume that the other parameters of the rig are exact.
    """
    centre = mode.fit.logs[1:3]
    logs = _solve_logs(centre, rig)
    step = 1e-5
    shifts = step * np.eye(2)
    rises = [_solve_logs(centre + s, rig) - _solve_logs(centre - s, rig) for s in shifts]
    slopes = np.column_stack(rises) / (2.0 * step)
    covariance = slopes @ mode.fit.covariance[1:3, 1:3] @ slopes.T
    reach = np.minimum(1.96 * np.sqrt(np.diag(covariance)), 50.0)
    f0, q = (Estimate(*one) for one in np.exp([logs, logs - reach, logs + reach]).T.tolist())
    share = acceleration.excursion_square(mode.level_of_x_max, mode.on_seat)
    require("f0_hz", f0, acceleration.WIDEST_F0, "measure the current as well")
    require("q_mechanical", q, 2.0 * acceleration.WIDEST_Q, "measure the current as well")
    # Qms excludes the electrical damping, so the relative effect of the level is larger.
    extent = acceleration.Q_BY_LEVEL * share * max(1.0, float(np.abs(slopes[1]).max()))
    return {
        "actuator.resonance_hz": f0.extend_down(acceleration.F0_BY_LEVEL * share),
        "actuator.q_mechanical": q.extend_down(extent),
    }


def _solve_logs(logs: FloatArray, rig: Rig) -> FloatArray:
    """Return the logs of f0 and Qms. logs: logs of f0 and Q under voltage drive."""
    a = rig.actuator
    w, q = math.tau * math.exp(logs[0]), math.exp(logs[1])
    real = -w / (2.0 * q)
    pole = complex(real, math.sqrt(max(w**2 - real**2, 0.0)))
    if pole.imag <= 0.0:
        raise IdentificationError(
            f"q={q:.3g} of the mode must be above 0.5: it does not ring, so f0 and Qms do not "
            "follow; measure the current as well"
        )
    motional = a.force_factor_n_per_a**2 / a.moving_mass_kg
    whole = -(pole**2) - motional * pole / a.coil_ohm(pole)
    rate = whole.imag / pole.imag
    square = whole.real - rate * pole.real
    if rate <= 0.0 or square <= 0.0:
        raise IdentificationError(
            f"the mode, Q {q:.3g}, is damped less than rig {rig.name!r} damps it electrically: "
            "force_factor_n_per_a, resistance_ohm, inductance_h or moving_mass_kg is wrong there; "
            "correct the rig, or measure the current as well"
        )
    return np.log([math.sqrt(square) / math.tau, math.sqrt(square) / rate])


WIDEST_MASS, WIDEST_BL = 0.2, 0.2


def by_known_mass(impedance: Impedance, mass: Estimate) -> Values:
    """Return the weighed moving mass, kg, and Bl, computed from the impedance and this mass."""
    half = {index: 0.5 * power for index, power in MOTIONAL.items()}
    alone = multiply_powers([(impedance.fit, half)], math.sqrt(math.tau * mass.value))
    spread = math.hypot(math.log(alone.high / alone.value), 0.5 * mass.relative)
    low, high = alone.value * math.exp(-spread), alone.value * math.exp(spread)
    return _checked(Estimate(alone.value, low, high), mass, "weigh the mass again")


def by_acceleration(impedance: Impedance, mode: acceleration.Mode) -> Values:
    """Return Bl and m from the impedance (Bl^2 / m) and acceleration per current (Bl / m).

    Both must be measured on solid ground, because a moving frame would change only the impedance.
    """
    force_factor, mass = (
        multiply_powers([(impedance.fit, MOTIONAL), (mode.fit, {0: power})], math.tau)
        for power in (-1.0, -2.0)
    )
    return _checked(force_factor, mass, "fasten the accelerometer to the moving part")


def _checked(force_factor: Estimate, mass: Estimate, advice: str) -> Values:
    require("force_factor_n_per_a", force_factor, WIDEST_BL, advice)
    require("moving_mass_kg", mass, WIDEST_MASS, advice)
    return {"actuator.force_factor_n_per_a": force_factor, "actuator.moving_mass_kg": mass}
