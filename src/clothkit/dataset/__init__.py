"""Raw parquet, regularisation, the zarr store, splits and augmentation."""
