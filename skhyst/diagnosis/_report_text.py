"""The form in which a report writes a value, its error and a change."""

import math


def _powers(exponent):
    """Write a power of ten."""
    return f" × 10{str(exponent).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"


def number(value, digits=3):
    """Write a number with so many significant digits; a dash if there is none.

    Examples
    --------
    >>> number(0.04125), number(123456.0), number(3.2e-7), number(float("nan"))
    ('0.0413', '123456', '3.20 × 10⁻⁷', '–')
    """
    if value is None or not math.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    exponent = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    if -4 <= exponent < 7:
        return _signed(f"{value:.{max(digits - 1 - exponent, 0)}f}")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{_signed(mantissa)}{_powers(int(power))}"


def plus_minus(value, std):
    """Write a value with its standard error, two significant digits of the smaller of both.

    Examples
    --------
    >>> plus_minus(0.60132, 0.0041), plus_minus(1234.5, 21.0), plus_minus(2.0, float("nan"))
    ('0.6013 ± 0.0041', '1234 ± 21', '2.000')
    >>> plus_minus(0.0842, 20.3)
    '0.084 ± 20'
    >>> plus_minus(3.14159e-7, 2.1e-9)
    '(3.142 ± 0.021) × 10⁻⁷'
    """
    if value is None or not math.isfinite(value):
        return "–"
    if std is None or not math.isfinite(std) or std <= 0:
        return number(value, 4)
    exponent = math.floor(math.log10(max(abs(value), std)))
    scale = exponent if not -4 <= exponent < 7 else 0
    value, std = value / 10.0**scale, std / 10.0**scale
    smaller = min(max(abs(value), 1e-3 * std), std)
    decimals = min(max(0, 1 - math.floor(math.log10(smaller))), 12)
    text = f"{_signed(f'{value:.{decimals}f}')} ± {_rounded(std)}"
    return f"({text}){_powers(scale)}" if scale else text


def _rounded(std):
    """Write a standard error with two significant digits, at most 12 decimals."""
    return f"{std:.{min(max(0, 1 - math.floor(math.log10(std))), 12)}f}"


def _signed(text):
    """Replace the hyphen of a negative number by a minus sign."""
    return text.replace("-", "−")


def share(value):
    """Write a fraction as a percentage, with two digits.

    Examples
    --------
    >>> share(0.9234), share(0.0341), share(2e-9), share(0.9961), share(0.99997)
    ('92 %', '3.4 %', '< 0.1 %', '99.6 %', '> 99.9 %')
    """
    if 0.995 <= value < 1.0:
        return "> 99.9 %" if value > 0.999 else f"{100.0 * value:.1f} %"
    return f"{number(100.0 * value, 2)} %" if value >= 0.001 else "< 0.1 %"


def probability(p_value):
    """Write a p-value; below 1e-12, where no assumption about the noise holds, as a bound.

    Examples
    --------
    >>> probability(0.00213), probability(0.0), probability(None)
    ('0.0021', '< 10⁻¹²', '–')
    """
    return "< 10⁻¹²" if p_value is not None and p_value < 1e-12 else number(p_value, 2)


def chance(p_value):
    """Write a p-value with its symbol.

    Examples
    --------
    >>> chance(0.00213), chance(0.0)
    ('p = 0.0021', 'p < 10⁻¹²')
    """
    text = probability(p_value)
    return f"p {text}" if text[0] == "<" else f"p = {text}"


def percent(value, whole):
    """Write a value as a percentage of another.

    Examples
    --------
    >>> percent(0.0231, 1.0), percent(1.0, 0.0)
    ('2.31 %', '–')
    """
    return f"{number(100.0 * value / whole)} %" if whole and value is not None else "–"


def change(before, after):
    """Write the relative change of an error.

    Examples
    --------
    >>> change(2.0, 0.5), change(2.0, 2.1), change(2.0, 2.0001), change(2.0, 30.0), change(0.0, 1.0)
    ('−75.0 %', '+5.0 %', '0.0 %', '15 times', '–')
    """
    if not before or after is None or not math.isfinite(after):
        return "–"
    if after > 3.0 * before:
        return f"{number(after / before, 2)} times"
    text = f"{100.0 * (after / before - 1.0):+.1f} %"
    return "0.0 %" if text[1:] == "0.0 %" else _signed(text)


def listed(names):
    """Join names by commas, and the last two by "and".

    Examples
    --------
    >>> listed(["a"]), listed("ab"), listed("abc")
    ('a', 'a and b', 'a, b and c')
    """
    names = [str(name) for name in names]
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
