"""Controllers that are not trained here: ONNX and Stable-Baselines3 files, plain functions."""
