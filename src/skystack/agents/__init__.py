"""Controllers that skystack did not train: ONNX and Stable-Baselines3 files, plain functions."""
