"""What users, files and peers give where a number, a path, an address or a file is expected."""

import datetime
import json
import os
from pathlib import Path

import numpy as np
from hypothesis import strategies as st


def words(text: str) -> list[str]:
    return text.split()


ODD_NUMBERS = words("nan inf -inf 1e400 -3 0 1 2.5 0x10 \u00b2 \u0661 1_0 true 70000 2147483648 1e-400 -0.0 --")
NUMBERS = st.one_of(
    st.sampled_from([*ODD_NUMBERS, "", " ", "9" * 401, "9" * 5000, "-" + "9" * 5000]),
    st.integers().map(str),
    st.floats().map(repr),
)
ODD_TEXTS = words(". / // [/x] [x] [bold] :smile: {0} {x} %s %(x)s $x$ * \u00e9 a/../b a::b s3:// x://y http://[")
# What argv can hold: no NUL, and bytes that are not UTF-8 as Python shows them.
TEXTS = st.one_of(
    st.sampled_from([*ODD_TEXTS, "", "a\nb", "a" * 300, "\udce9", "\x1b]0;x\x07", "\u202eabc"]),
    st.text(st.characters(exclude_characters="\0", exclude_categories=("Cs",)), max_size=30),
    st.binary(max_size=12).map(lambda data: os.fsdecode(data.replace(b"\0", b"-"))),
)
# Those of them that stay in the campaign's folder, whatever is written there.
WRITTEN = TEXTS.map(lambda text: text.replace("..", "--").lstrip("/~ \t\n"))
ODD_PATHS = words("/dev/null /dev/zero /nonexistent/x /etc /etc/passwd .. ../.. run run/progress.csv file/x")
PATHS = st.one_of(TEXTS, st.sampled_from([*ODD_PATHS, "/".join(["a" * 200] * 25)]))
ODD_HOSTS = (
    "::1 [::1] [::] :: 0.0.0.0 127.0.0.1 127.1 localhost ::ffff:127.0.0.1 192.0.2.1 fe80::1%lo [127.0.0.1] a..b "
    "unix:/tmp/x dns:///a ipv6:[::1] [ ] [] : [::1"
)
HOSTS = st.one_of(st.sampled_from([*ODD_HOSTS.split(), "", "x" * 70]), TEXTS.map("{}.invalid".format))
ADDRESSES = st.one_of(
    st.builds("{}:{}".format, HOSTS, NUMBERS | st.just("7111")), PATHS, st.sampled_from(["builtin", "editor"])
)
SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=20),
    st.just(5000).map(lambda digits: 10**digits),
    st.sampled_from([10**401, -(10**401), "1e400", "nan", b"x", datetime.date(2020, 1, 1), 1j, Path("x"), {1, 2}]),
    st.sampled_from([np.int64(2), np.float32(1.5), np.array(3.0), np.array([1, 2]), np.bool_(True), np.longdouble(1)]),
    st.sampled_from([np.float64("nan"), np.array(10**30), np.datetime64("2020"), np.str_("2"), object()]),
)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=6,
)
ODD_YAML = words("2020-13-45 .nan .inf !!python/name:os.system 1:99:99 {a:b}:c ' 0o777 ~ '1e400' &a[*a] {[1]:2}")
ODDER_YAML = (
    "!!int x",
    "!!timestamp x",
    "&a [*a]",
    "{? [1] : 2}",
    "{sampler_type: gaussian, sampler_parameters: {mean: .nan, st_dev: -1}}",
    "{sampler_type: [], sampler_parameters: 1}",
    "0x" + "f" * 5000,
    "1" + "0" * 400,
    "[" * 3000,
    "\t",
)
YAML_VALUES = NUMBERS | st.sampled_from([*ODD_YAML, *ODDER_YAML])
BOMB = "\n".join(["a0: &a0 [x]", *(f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]" for n in range(12))])
ODD_FILES = (b"", b"\xef\xbb\xbfa: 1", b"[" * 100_000, b"{" * 5000, BOMB.encode(), b"x" * (2**20 + 1), b"- 1", b"\0")
FILES = st.one_of(
    st.binary(max_size=60),
    st.sampled_from(ODD_FILES),
    st.text(max_size=40).map(lambda text: text.encode("utf-8", "surrogatepass")),
    VALUES.map(lambda value: json.dumps(value, default=str).encode() if _is_writable(value) else b"[1"),
)


def _is_writable(value: object) -> bool:
    try:
        json.dumps(value, default=str)
    except ValueError:  # 5,000 digits
        return False
    return True
