"""A server of a file that `lfref export` wrote as ONNX; it needs litserve and onnxruntime, and not lfref.

`python serve.py MODEL.onnx --port 8000`. A request holds the inputs of the model one after the other, each as `np.save`
writes it; the answer is the stack, likewise.
"""

import argparse
import io
import signal
from typing import Annotated

import litserve
import numpy as np
import onnxruntime
from fastapi import Body, HTTPException, Response

LARGEST_REQUEST = 500_000_000
"""Bytes: four light fields of 7x7 views of 375x540 pixels in float32."""


class Refocus(litserve.LitAPI):
    """Views, and slopes if the model takes them, to a stack."""

    def __init__(self, model: str) -> None:
        super().__init__()
        self.model = model

    def setup(self, device: str) -> None:
        """Load the model, in the process that computes."""
        self.session = onnxruntime.InferenceSession(self.model)

    def decode_request(self, request: Annotated[bytes, Body()]) -> bytes:
        """The body as it is."""
        return request

    def predict(self, request: bytes) -> np.ndarray:
        """The stack; several light fields, with one more axis before the views, are refocused one after the other."""
        file, (first, *others) = io.BytesIO(request), self.session.get_inputs()
        try:
            views = np.load(file, allow_pickle=False)
            rest = {value.name: np.load(file, allow_pickle=False) for value in others}
            is_batch = views.ndim > len(first.shape)
            fields = views if is_batch else [views]
            stacks = [self.session.run(["stack"], {first.name: field} | rest)[0] for field in fields]
            return np.stack(stacks) if is_batch else stacks[0]
        except Exception as error:  # no array, or of another shape or type than the model reads
            raise HTTPException(400, str(error)) from error

    def encode_response(self, stack: np.ndarray) -> Response:
        """The stack as `np.save` writes it."""
        np.save(file := io.BytesIO(), stack)
        return Response(file.getvalue(), media_type="application/octet-stream")


def main() -> None:
    """Serve until a signal comes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("--port", type=int, default=8000)
    parser.add_argument("--host", default="127.0.0.1")
    options = parser.parse_args()
    # LitServe ends its processes after Ctrl+C only; a container or service manager sends SIGTERM.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    server = litserve.LitServer(Refocus(options.model), accelerator="cpu", max_payload_size=LARGEST_REQUEST)
    server.run(host=options.host, port=options.port, generate_client_file=False)


if __name__ == "__main__":
    main()
