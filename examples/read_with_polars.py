"""Read the pairs with Polars alone: how many pairs are there, and how good are they, by overlap?"""

import sys

import polars as pl

folder = sys.argv[1] if len(sys.argv) > 1 else "data/dataset"
pairs = pl.scan_parquet(f"{folder}/pairs/*.parquet")

bins = pl.col("overlap").cut([0.1, 0.25, 0.5], labels=["< 0.1", "0.1-0.25", "0.25-0.5", "> 0.5"])
print(
    pairs.group_by(bins.alias("overlap"))
    .agg(
        pl.len().alias("pairs"),
        pl.col("range_m").median(),
        pl.col("slam_position_error_0_m").median(),
        pl.col("wall_agreement_local").median(),
    )
    .sort("overlap")
    .collect()
)
