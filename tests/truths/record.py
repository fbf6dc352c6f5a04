"""One comparison of a truth with what clradar gives."""

from dataclasses import dataclass

MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Row:
    """A number, what it should be, and the bound on their difference; with `at_most` on what was
    found by itself. `digits` are those after the point in tables."""

    case: str
    expected: float
    found: float
    bound: float
    unit: str = "dB"
    digits: int = 2
    at_most: bool = False

    @property
    def error(self) -> float:
        return self.found if self.at_most else abs(self.found - self.expected)

    @property
    def holds(self) -> bool:
        return self.error <= self.bound

    def cells(self) -> list[str]:
        """Cells of a table: case, truth, clradar, difference, bound, whether it holds."""

        def text(value: float) -> str:
            return f"{value:.{self.digits}f}".replace("-", MINUS)

        unit = f" {self.unit}" if self.unit else ""
        answer = "yes" if self.holds else "**no**"
        if self.at_most:
            return [self.case, "", text(self.found) + unit, "", "≤ " + text(self.bound), answer]
        return [
            self.case,
            text(self.expected) + unit,
            text(self.found) + unit,
            text(self.found - self.expected),
            "± " + text(self.bound),
            answer,
        ]
