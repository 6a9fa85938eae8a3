"""Functions of fixed-point arithmetic in C.

``{n}`` is the name of the function, ``{product}`` and such are those of others that it calls.
Argument and result have ``fa`` and ``f`` binary digits after the point, intermediate numbers 55 to
60. The number of iterations of every loop is bounded.

Arithmetic saturates: arguments are from -2^62 to 2^62, and results are limited to the same range.
No operation overflows, and no negative number is shifted.
"""

# all with 60 binary digits: log2(e), ln(2), pi; with 62: 1 / (2 pi)
CONSTANTS = {
    "LOG2E": "1663314137230540311",
    "LN2": "799144290325165979",
    "PI": "3622009729038561421",
    "TURN": "733972625820500307",
    **{f"TWO_{k}": f"INT64_C({2**k})" for k in (58, 60, 61, 62)},  # powers of two
    "TERMS": "24",  # number of terms of a series, so that the last is below 2^-62
}

FUNCTIONS = {
    "two_to": """\
/* 2^n, for n from 0 to 62 */
static int64_t {n}(int32_t n)
{{
    const uint32_t place = (uint32_t)n;
    const uint64_t power = (uint64_t)1 << place;
    return (int64_t)power;
}}
""",
    "sum": """\
/* a + b */
static int64_t {n}(int64_t a, int64_t b)
{{
    const int64_t most = {TWO_62};
    if (b > 0) {{
        return a > most - b ? most : a + b;
    }}
    return a < -most - b ? -most : a + b;
}}
""",
    "to_int32": """\
/* a, limited to 32 bits */
static int32_t {n}(int64_t a)
{{
    return a > INT32_MAX ? INT32_MAX : a < -INT32_MAX ? -INT32_MAX : (int32_t)a;
}}
""",
    "floor": """\
/* the largest integer not above a / 2^n */
static int64_t {n}(int64_t a, int32_t n)
{{
    const uint32_t down = (uint32_t)n;
    uint64_t y = a < 0 ? ~(uint64_t)a + 1u : (uint64_t)a;
    y += a < 0 ? (uint64_t){two_to}(n) - 1u : 0u;
    y >>= down;
    return a < 0 ? -(int64_t)y : (int64_t)y;
}}
""",
    "shift": """\
/* a / 2^n, rounded */
static int64_t {n}(int64_t a, int32_t n)
{{
    const uint32_t down = (uint32_t)n;
    uint64_t y = a < 0 ? ~(uint64_t)a + 1u : (uint64_t)a;
    if (n > 62) {{
        return 0;
    }}
    y += (uint64_t){two_to}(n - 1);
    y >>= down;
    return a < 0 ? -(int64_t)y : (int64_t)y;
}}
""",
    "product": """\
/* a b / 2^n, rounded, for n from 0 to 126 */
static int64_t {n}(int64_t a, int64_t b, int32_t n)
{{
    const uint64_t most = (uint64_t)1 << 62u;
    const uint64_t x = a < 0 ? ~(uint64_t)a + 1u : (uint64_t)a;
    const uint64_t y = b < 0 ? ~(uint64_t)b + 1u : (uint64_t)b;
    const uint64_t least = (x & 0xffffffffu) * (y & 0xffffffffu);
    const uint64_t cross = (x >> 32u) * (y & 0xffffffffu) + (least >> 32u);
    const uint64_t other = (x & 0xffffffffu) * (y >> 32u) + (cross & 0xffffffffu);
    uint64_t low = other << 32u | (least & 0xffffffffu);
    uint64_t high = (x >> 32u) * (y >> 32u) + (cross >> 32u) + (other >> 32u);
    if (n > 0) {{
        const uint32_t place = ((uint32_t)n - 1u) % 64u;
        const uint64_t half = (uint64_t)1 << place;
        const uint64_t before = low;
        low += n <= 64 ? half : 0u;
        high += (low < before ? 1u : 0u) + (n > 64 ? half : 0u);
        if (n >= 64) {{
            low = high;
            high = 0u;
            n -= 64;
        }}
        if (n > 0) {{
            const uint32_t down = (uint32_t)n;
            const uint32_t up = 64u - down;
            low = low >> down | high << up;
            high >>= down;
        }}
    }}
    low = high > 0u || low > most ? most : low;
    return (a < 0) != (b < 0) ? -(int64_t)low : (int64_t)low;
}}
""",
    "ratio": """\
/* a 2^n / b, for n from 0 to 126; the largest number where b is zero */
static int64_t {n}(int64_t a, int64_t b, int32_t n)
{{
    const uint64_t most = (uint64_t)1 << 62u;
    const uint64_t x = a < 0 ? ~(uint64_t)a + 1u : (uint64_t)a;
    const uint64_t y = b < 0 ? ~(uint64_t)b + 1u : (uint64_t)b;
    uint64_t whole = y > 0u ? x / y : most;
    uint64_t rest = y > 0u ? x % y : 0u;
    while (n > 0) {{
        rest *= 2u;
        whole = whole >= most / 2u ? most : 2u * whole + (rest >= y && y > 0u ? 1u : 0u);
        rest -= rest >= y ? y : 0u;
        n--;
    }}
    return (a < 0) != (b < 0) ? -(int64_t)whole : (int64_t)whole;
}}
""",
    "rescaled": """\
/* a with f digits instead of fa; limited to 2^62 */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t most = {TWO_62};
    if (f <= fa) {{
        return f < fa ? {shift}(a, fa - f) : a;
    }}
    if (f - fa > 62) {{
        return a > 0 ? most : a < 0 ? -most : 0;
    }}
    if (a > {two_to}(62 - f + fa) || a < -{two_to}(62 - f + fa)) {{
        return a > 0 ? most : -most;
    }}
    return a * {two_to}(f - fa);
}}
""",
    "rescaled_finite": """\
/* a with f digits instead of fa; one that represents infinity is unchanged */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t most = {TWO_62};
    return a >= most || a <= -most ? a : {rescaled}(a, fa, f);
}}
""",
    "exp": """\
/* e^a = 2^k e^r with |r| at most ln(2) / 2 and a series for e^r */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_60};
    const int64_t limited = {rescaled}(a, fa, 55);
    const int64_t k = {product}(limited, {LOG2E}, 115);
    const int64_t rest = limited - {product}(k, {LN2}, 5);
    const int64_t r = k == 0 ? {rescaled}(a, fa, 60) : {rescaled}(rest, 55, 60);
    int64_t y = one;
    for (int32_t i = {TERMS}; i > 0; i--) {{
        y = one + {product}(r, y, 60) / i;
    }}
    return {rescaled}(y, 60 - (int32_t)k, f);
}}
""",
    "expm1": """\
/* near zero a (1 + a / 2 + a^2 / 6 + ...), with the digits of a */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_60};
    const int32_t g = f > 60 ? 60 : f < 0 ? 0 : f;
    const int64_t r = {rescaled}(a, fa, 60);
    if (r > -one / 2 && r < one / 2) {{
        int64_t y = one;
        for (int32_t i = {TERMS}; i > 1; i--) {{
            y = one + {product}(r, y, 60) / i;
        }}
        return {rescaled}({product}(a, y, 60), fa, f);
    }}
    return {rescaled}({exp}(a, fa, g) - {two_to}(g), g, f);
}}
""",
    "tanh": """\
/* (1 - e^-2|a|) / (1 + e^-2|a|) */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_60};
    const int64_t decay = {exp}(a < 0 ? a : -a, fa - 1, 60);
    const int64_t size = {ratio}(one - decay, one + decay, 60);
    return {rescaled}(a < 0 ? -size : size, 60, f);
}}
""",
    "log_ratio": """\
/* log((1 + z) / (1 - z)) = 2 (z + z^3 / 3 + ...), z with 60 digits and at most 1/3 */
static int64_t {n}(int64_t z)
{{
    const int64_t square = {product}(z, z, 60);
    int64_t y = 0;
    for (int32_t i = 2 * {TERMS} - 1; i > 0; i -= 2) {{
        y = {TWO_60} / i + {product}(square, y, 60);
    }}
    return {product}(z, y, 59);
}}
""",
    "log": """\
/* log(m 2^k) with m from 1 to 2; the least number where a is not above zero */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_61};
    int32_t k = 61 - fa;
    if (a <= 0) {{
        return -{TWO_62};
    }}
    while (a >= 2 * one - 1) {{
        a /= 2;
        k++;
    }}
    while (a < one) {{
        a *= 2;
        k--;
    }}
    a = {log_ratio}({ratio}(a - one, a + one, 60));
    if (k == 0) {{
        return {rescaled}(a, 60, f);
    }}
    return {rescaled}({shift}(a, 5) + {product}(k, {LN2}, 5), 55, f);
}}
""",
    "log1p": """\
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_60};
    const int64_t x = {rescaled}(a, fa, 60);
    const int32_t g = fa > 60 ? 60 : fa < 0 ? 0 : fa;
    if (x > -one / 4 && x < one / 2) {{
        return {rescaled}({log_ratio}({ratio}(x, 2 * one + x, 60)), 60, f);
    }}
    return {log}({rescaled}(a, fa, g) + {two_to}(g), g, f);
}}
""",
    "pow": """\
/* e^(b log(a)); b has fb digits */
static int64_t {n}(int64_t a, int64_t b, int32_t fa, int32_t fb, int32_t f)
{{
    if (a > 0) {{
        return {exp}({product}(b, {log}(a, fa, 55), fb), 55, f);
    }}
    return b > 0 ? 0 : {rescaled}(b < 0 ? {TWO_62} : 1, 0, f);
}}
""",
    "cos": """\
/* a series, after reduction by full periods */
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int64_t one = {TWO_58};
    const int32_t g = fa > 56 ? 56 : fa < 0 ? 0 : fa;
    const int64_t x = {rescaled}(a, fa, g);
    const int64_t r = {rescaled}(x - {product}({product}(x, {TURN}, g + 62), {PI}, 59 - g), g, 58);
    const int64_t square = {product}(r, r, 58);
    int64_t y = one;
    for (int32_t i = {TERMS}; i > 0; i--) {{
        y = one - {product}(square, y, 58) / (2 * i * (2 * i - 1));
    }}
    return {rescaled}(y, 58, f);
}}
""",
    "sin": """\
static int64_t {n}(int64_t a, int32_t fa, int32_t f)
{{
    const int32_t g = fa > 56 ? 56 : fa < 0 ? 0 : fa;
    return {cos}({rescaled}(a, fa, g) - {shift}({PI}, 61 - g), g, f);
}}
""",
}
