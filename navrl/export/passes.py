"""Simplifications of an exported graph that ONNX Runtime does not make."""

from __future__ import annotations

import onnx_ir
from onnx_ir.passes.common import CommonSubexpressionEliminationPass


def simplify(model: onnx_ir.Model) -> None:
    """Remove source traces and repeated work of an ONNX model in place; results do not change."""
    for node in onnx_ir.traversal.RecursiveGraphIterator(model.graph):
        node.metadata_props.clear()
        node.doc_string = None
    for node in list(model.graph):
        if node.op_type == "Loop":
            _hoist(model.graph, node)
    graphs = [model.graph]
    graphs += [attribute.as_graph() for node in model.graph for attribute in _subgraphs(node)]
    for graph in graphs:
        part = onnx_ir.Model(graph, ir_version=model.ir_version)
        CommonSubexpressionEliminationPass()(part)
    _drop_unused(model.graph)


def _hoist(graph: onnx_ir.Graph, loop: onnx_ir.Node) -> None:
    """Move the nodes of a loop's body that do not depend on the iteration before the loop."""
    body = loop.attributes["body"].as_graph()
    _fix_shapes(body, loop)
    varying = set(body.inputs)
    results = set(body.outputs)
    for node in list(body):
        depends = any(value in varying for value in node.inputs)
        if depends or _subgraphs(node) or results & set(node.outputs):
            varying |= set(node.outputs)
            continue
        body.remove(node)
        graph.insert_before(loop, node)


def _drop_unused(graph: onnx_ir.Graph) -> None:
    """Remove nodes and constants without effect, of which ONNX Runtime would warn.

    onnx_ir's own pass keeps what a loop read that the exporter has removed.
    """
    used = set(graph.outputs)
    for node in reversed(list(graph)):
        if used & set(node.outputs):
            used |= _read(node)
        else:
            graph.remove(node)
    for name in [name for name, value in graph.initializers.items() if value not in used]:
        del graph.initializers[name]


def _read(node: onnx_ir.Node) -> set[onnx_ir.Value | None]:
    """Return the values that a node and its graphs read."""
    read = set(node.inputs)
    for attribute in _subgraphs(node):
        body = attribute.as_graph()
        read |= set(body.outputs)
        for inner in onnx_ir.traversal.RecursiveGraphIterator(body):
            read |= set(inner.inputs)
    return read


def _fix_shapes(body: onnx_ir.Graph, loop: onnx_ir.Node) -> None:
    """Read shapes of carried values from the values before the loop: torch allows no change."""
    before = dict(zip(body.inputs[2:], loop.inputs[2:], strict=True))
    for node in body:
        if node.op_type == "Shape" and node.inputs[0] in before:
            node.replace_input_with(0, before[node.inputs[0]])


def _subgraphs(node: onnx_ir.Node) -> list[onnx_ir.Attr]:
    kind = onnx_ir.AttributeType.GRAPH
    return [each for each in node.attributes.values() if each.type == kind]
