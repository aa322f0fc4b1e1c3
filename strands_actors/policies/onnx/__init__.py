"""Policies in the ONNX format: a network (``*.onnx``) with a ``manifest.json`` for its inputs and outputs."""
