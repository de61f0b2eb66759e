"""Rules of the operators that multiply: how large their outputs are, and how much work they take."""

from __future__ import annotations

import math

from athrl_driving.policy.graph.values import FLOAT, NodeView, Outcome, Value, checked_shape


def gemm(node: NodeView) -> Outcome:
    """A product of two matrices, and something added."""
    a, b = node.shape(0), node.shape(1)
    if len(a) != 2 or len(b) != 2:
        raise node.error(f"multiplies {list(a)} and {list(b)}")
    a = a[::-1] if node.whole("transA", 0) else a
    b = b[::-1] if node.whole("transB", 0) else b
    return _product(node, a, b)


def matmul(node: NodeView) -> Outcome:
    """Products of matrices."""
    a, b = node.shape(0), node.shape(1)
    if len(a) < 2 or len(b) < 2:
        raise node.error(f"multiplies {list(a)} and {list(b)}; both should have two axes or more")
    return _product(node, a, b)


def _product(node: NodeView, a: tuple[int, ...], b: tuple[int, ...]) -> Outcome:
    if a[-1] != b[-2]:
        raise node.error(f"multiplies {list(a)} and {list(b)}")
    _refuse_whole_numbers(node)
    output = Value((*node.broadcast([a[:-2], b[:-2]]), a[-2], b[-1]))
    return Outcome([output], output.size * a[-1])


def _refuse_whole_numbers(node: NodeView) -> None:
    """Products of whole numbers are slow."""
    if any(value is not None and value.dtype != FLOAT for value in node.values):
        raise node.error("computes with whole numbers; it should be float32")


def conv(node: NodeView) -> Outcome:
    """A convolution of images."""
    data, weights, groups = node.shape(0), node.shape(1), node.whole("group", 1)
    if len(data) != 4 or len(weights) != 4 or groups < 1 or data[1] != weights[1] * groups:
        raise node.error(f"convolves {list(data)} with {list(weights)}; it should fit an image")
    if node.has("kernel_shape") and node.wholes("kernel_shape") != list(weights[2:]):
        raise node.error("has another kernel than its weights")
    output = Value((data[0], weights[0], *_window(node, data[2:], weights[2:])))
    _refuse_whole_numbers(node)
    # One image at a time is laid out so that the convolution is a product of matrices.
    return Outcome(
        [output],
        products=output.size * math.prod(weights[1:]),
        scratch=math.prod(output.shape[2:]) * math.prod(weights[1:]),
    )


def pool(node: NodeView) -> Outcome:
    """The mean or maximum of what is in a window."""
    data, kernel = node.shape(), node.wholes("kernel_shape") or []
    if len(data) != 4 or len(kernel) != 2:
        raise node.error(f"pools {list(data)}; it should be an image")
    output = Value((*data[:2], *_window(node, data[2:], tuple(kernel))))
    return Outcome([output], output.size * math.prod(kernel))


def _window(node: NodeView, sizes: tuple[int, ...], kernel: tuple[int, ...]) -> tuple[int, ...]:
    """Height and width of what a window that moves over an image gives."""
    pads, strides = node.wholes("pads") or [0] * 4, node.wholes("strides") or [1, 1]
    dilations = node.wholes("dilations") or [1, 1]
    if node.has("auto_pad") or node.has("ceil_mode"):
        raise node.error("has auto_pad or ceil_mode; give its pads")
    if len(pads) != 4 or len(strides) != 2 or len(dilations) != 2 or min(*pads, *kernel) < 0:
        raise node.error("has pads, strides or dilations that do not fit an image")
    if min(*strides, *dilations, *kernel) < 1:
        raise node.error("has strides, dilations or a kernel below 1")
    spans = [dilation * (size - 1) + 1 for dilation, size in zip(dilations, kernel, strict=True)]
    padded = [size + pads[n] + pads[n + 2] for n, size in enumerate(sizes)]
    return checked_shape(
        (whole - span) // stride + 1 for whole, span, stride in zip(padded, spans, strides, strict=True)
    )


def global_pool(node: NodeView) -> Outcome:
    """The mean or maximum of each channel."""
    shape = node.shape()
    return Outcome([Value((*shape[:2], *(1 for _ in shape[2:])), node.value(0).dtype)])
