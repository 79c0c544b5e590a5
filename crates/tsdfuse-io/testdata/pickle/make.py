"""Writes the small pickles beside this file: one table of seven points, as different versions of pandas store it.

Run with each version of pandas that MADE names; the versions' layouts differ, the numbers do not.
"""

import gzip
import sys
from pathlib import Path

import numpy as np
import pandas as pd

MADE = {  # version of pandas: file, protocol, how
    "0.25": [("pandas0.25_p2.pkl", 2, "plain"), ("pandas0.25_text_index_p4.pkl", 4, "text_index")],
    "1.0": [("pandas1.0_p3.pkl.gz", 3, "plain")],  # what PandaSet itself uses
    "1.3": [("pandas1.3_p4.pkl", 4, "plain")],
    "1.5": [("pandas1.5_scattered_p2.pkl", 2, "scattered"), ("pandas1.5_selected_p5.pkl", 5, "selected")],
    "2.3": [("pandas2.3_p5.pkl", 5, "plain"), ("pandas2.3_mixed_p4.pkl", 4, "mixed"), ("pandas2.3_rows_p4.pkl", 4, "rows"), ("pandas2.3_rows_p5.pkl", 5, "rows")],
    "3.0": [("pandas3.0_p5.pkl", 5, "plain")],
}

k = np.arange(7)
table = pd.DataFrame(
    {"x": k * 1.5 - 3, "y": k * 2.25, "z": k * -0.5, "i": k * 10.0, "t": 1557539960 + k * 0.0078125, "d": (k > 3) * 1}
)
rows = pd.DataFrame(np.ascontiguousarray(table[list("xyzit")].values), columns=list("xyzit"))
rows["d"] = table.d
made = {
    "plain": table,
    "text_index": table.set_index(pd.Index(list("abcdefg"))),
    # One block whose columns are not neighbours.
    "scattered": pd.DataFrame({c: table[c] for c in "xdyzit"}).assign(q=table.d * 2).copy(),
    # A selection of rows: an index of integers, arrays that are not contiguous.
    "selected": pd.concat([table, table])[(np.arange(14) % 2 == 0)].sort_values("t"),
    # Other types, another order, and a column of text that nobody asks for.
    "mixed": table[list("dtiyxz")].astype({"x": ">f8", "y": "f4", "i": "u1", "d": "i1"}).assign(name="point"),
    # Made from a matrix with one row per point: stored in Fortran order.
    "rows": rows,
}
for name, protocol, how in MADE[".".join(pd.__version__.split(".")[:2])]:
    if "pandas3.0" in name and "pyarrow" in sys.modules:
        name = name.replace("3.0", "3.0_arrow")
    path = Path(__file__).with_name(name)
    made[how].to_pickle(path, protocol=protocol, compression=None)
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(path.read_bytes(), mtime=0))
