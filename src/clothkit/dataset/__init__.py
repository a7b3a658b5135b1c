"""Datasets: raw parquet tables, regularisation to grids, zarr stores, splits, augmentation and export."""
