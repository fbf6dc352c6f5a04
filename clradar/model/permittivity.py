"""Complex relative permittivity over frequency, eps' - j eps'' for the time factor exp(+j w t)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from clradar.constants import PLAUSIBLE_HZ, VACUUM_PERMITTIVITY_F_PER_M
from clradar.errors import ModelError
from clradar.model import checks
from clradar.model.plausible import check_plausible
from clradar.model.record import Record

MAX_POLES = 16
MAX_EXPONENT = 10.0
MAX_TABLE_ROWS = 2000  # more would not fit into a file of materials
LONGEST_TAU_S = 1.0
"""The slowest relaxations of tissue take some 20 ms; a time in picoseconds is larger."""


@dataclass(frozen=True, slots=True, repr=False)
class ColeCole(Record):
    """Permittivity by Debye or Cole-Cole terms and a conductivity::

        eps_inf + sum_i delta_i / (1 + (j w tau_i)^(1 - alpha_i)) + sigma / (j w eps_0)

    (K. S. Cole, R. H. Cole, J. Chem. Phys. 9 (1941) 341).

    Parameters
    ----------
    eps_inf : float
        Permittivity far above all relaxations.
    poles : sequence of (delta, tau_s) or (delta, tau_s, alpha)
        Strength, relaxation time in seconds, and broadening in [0, 1), 0 for Debye; at most 16.
    sigma_s_per_m : float
        Static conductivity.

    Examples
    --------
    >>> skin = clradar.ColeCole(4.0, [(32, 7.234e-12), (1100, 32.48e-9, 0.2)], 2e-4)
    >>> print(f"{skin.at(77e9)[0]:.2f}")
    6.56-8.91j
    """

    eps_inf: float
    poles: Sequence[Sequence[float]] = ()
    sigma_s_per_m: float = 0.0

    def __post_init__(self) -> None:
        poles = self.poles
        if isinstance(poles, str) or not isinstance(poles, Iterable):
            checks.fail("ColeCole.poles", "a list of (delta, tau_s, alpha)", repr(poles))
        rows = tuple(_pole(f"ColeCole.poles[{at}]", pole) for at, pole in enumerate(poles))
        if len(rows) > MAX_POLES:
            checks.fail("ColeCole.poles", f"at most {MAX_POLES} poles", f"{len(rows)}")
        self._set(
            eps_inf=checks.positive("ColeCole.eps_inf", self.eps_inf),
            poles=rows,
            sigma_s_per_m=_not_negative("ColeCole.sigma_s_per_m", self.sigma_s_per_m),
        )

    def at(self, frequency_hz: Any) -> np.ndarray:
        """Return the permittivity, complex128, shape (n,), at frequencies in hertz."""
        omega = 2 * np.pi * _frequencies(frequency_hz)
        eps = self.eps_inf + self.sigma_s_per_m / (1j * omega * VACUUM_PERMITTIVITY_F_PER_M)
        for delta, tau_s, alpha in self.poles:
            eps = eps + delta / (1 + (1j * omega * tau_s) ** (1 - alpha))
        return eps


@dataclass(frozen=True, slots=True, repr=False)
class PowerLaw(Record):
    """Permittivity as Recommendation ITU-R P.2040 has it for building materials.

    Parameters
    ----------
    a, b : float
        eps' = a f^b, f in gigahertz.
    c, d : float
        Conductivity c f^d in S/m; eps'' = conductivity / (2 pi f eps_0), f in hertz.
    """

    a: float
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0

    def __post_init__(self) -> None:
        self._set(a=checks.positive("PowerLaw.a", self.a), c=_not_negative("PowerLaw.c", self.c))
        for name in ("b", "d"):
            exponent = checks.real(f"PowerLaw.{name}", getattr(self, name))
            if abs(exponent) > MAX_EXPONENT:
                expected = f"an exponent from -{MAX_EXPONENT:g} to {MAX_EXPONENT:g}"
                checks.fail(f"PowerLaw.{name}", expected, f"{exponent:g}")
            self._set(**{name: exponent})

    def at(self, frequency_hz: Any) -> np.ndarray:
        """Return the permittivity, complex128, shape (n,), at frequencies in hertz."""
        frequencies = _frequencies(frequency_hz)
        sigma = self.c * (frequencies / 1e9) ** self.d
        loss = sigma / (2 * np.pi * frequencies * VACUUM_PERMITTIVITY_F_PER_M)
        return np.asarray(self.a * (frequencies / 1e9) ** self.b - 1j * loss, np.complex128)


@dataclass(frozen=True, slots=True, repr=False)
class PermittivityTable(Record):
    """Permittivity measured at some frequencies, linear in both parts between them.

    Parameters
    ----------
    frequency_hz : sequence of float
        At least two, ascending.
    permittivity : sequence of complex
        eps' - j eps'' at each.
    """

    frequency_hz: Sequence[float]
    permittivity: Sequence[complex]

    def __post_init__(self) -> None:
        field = "PermittivityTable.frequency_hz"
        axis = checks.one_axis(field, self.frequency_hz)
        check_plausible(field, "frequencies", axis, PLAUSIBLE_HZ, "Hz")
        if not 2 <= len(axis) <= MAX_TABLE_ROWS:
            checks.fail(field, f"2 to {MAX_TABLE_ROWS} frequencies", f"{len(axis)}")
        field = "PermittivityTable.permittivity"
        eps = checks.read_only(field, self.permittivity, np.complex128, (len(axis),))
        values = tuple(passive(field, value) for value in eps.tolist())
        self._set(frequency_hz=tuple(axis.tolist()), permittivity=values)

    def at(self, frequency_hz: Any) -> np.ndarray:
        """Return the permittivity, complex128, shape (n,), at frequencies within the table."""
        asked = _frequencies(frequency_hz)
        low, high = self.frequency_hz[0], self.frequency_hz[-1]
        if asked.min() < low or asked.max() > high:
            raise ModelError(
                f"expected frequencies within its table, {low / 1e9:.6g} to {high / 1e9:.6g} GHz, "
                f"got {asked.min() / 1e9:.6g} to {asked.max() / 1e9:.6g} GHz"
            )
        eps = np.asarray(self.permittivity, np.complex128)
        return np.asarray(np.interp(asked, self.frequency_hz, eps), np.complex128)


Permittivity: TypeAlias = complex | ColeCole | PowerLaw | PermittivityTable


def checked(field: str, value: Any) -> Permittivity:
    """Return a permittivity in its stored form: a record, or a passive complex number."""
    if isinstance(value, ColeCole | PowerLaw | PermittivityTable):
        return value
    if isinstance(value, str | bytes | bool | np.bool_) or not checks.is_single(value):
        expected = "a complex number, a ColeCole, a PowerLaw or a PermittivityTable"
        checks.fail(field, expected, type(value).__name__)
    try:
        number = complex(value)
    except (TypeError, ValueError, OverflowError):
        checks.fail(field, "a number", repr(value))
    return passive(field, number)


def passive(field: str, number: complex) -> complex:
    """Return a finite number whose real part is positive and imaginary part is not."""
    if not np.isfinite(number):
        checks.fail(field, "a finite number", f"{number}")
    if number.imag > 0:
        expected = "a passive permittivity, eps' - j eps'' with eps'' >= 0"
        checks.fail(field, expected, f"{number:g}, which has gain")
    if number.real <= 0:
        checks.fail(field, "a permittivity with a positive real part", f"{number:g}")
    return number


def permittivity_at(value: Permittivity, frequency_hz: Any) -> np.ndarray:
    """Return a permittivity, complex128, shape (n,), at frequencies in hertz."""
    if isinstance(value, ColeCole | PowerLaw | PermittivityTable):
        return value.at(frequency_hz)
    return np.full(len(_frequencies(frequency_hz)), value, np.complex128)


def _pole(field: str, pole: Any) -> tuple[float, float, float]:
    values = tuple(pole) if isinstance(pole, Iterable) and not isinstance(pole, str) else ()
    if len(values) not in (2, 3):
        checks.fail(field, "(delta, tau_s) or (delta, tau_s, alpha)", repr(pole))
    alpha = _not_negative(f"{field} alpha", values[2]) if len(values) == 3 else 0.0
    if alpha >= 1:
        checks.fail(f"{field} alpha", "a number in [0, 1)", f"{alpha:g}")
    delta = _not_negative(f"{field} delta", values[0])
    tau_s = checks.positive(f"{field} tau_s", values[1])
    if tau_s > LONGEST_TAU_S:
        checks.fail(
            f"{field} tau_s",
            f"a relaxation time in seconds, at most {LONGEST_TAU_S:g}",
            f"{tau_s:g}; did you mean {tau_s:g}e-12?",
        )
    return delta, tau_s, alpha


def _not_negative(field: str, value: Any) -> float:
    number = checks.real(field, value)
    if number < 0:
        checks.fail(field, "a number that is not negative", f"{number:g}")
    return number


def _frequencies(frequency_hz: Any) -> np.ndarray:
    if checks.is_single(frequency_hz):
        frequency_hz = [frequency_hz]
    values = checks.read_only("frequency_hz", frequency_hz, np.float64, (None,))
    check_plausible("frequency_hz", "frequencies", values, PLAUSIBLE_HZ, "Hz")
    return values
