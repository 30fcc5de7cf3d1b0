"""Which tube is it: names, anchors, maps."""
