"""Mode partitions for any task: which way a path goes, told by planes, reference paths or end points, without code."""
