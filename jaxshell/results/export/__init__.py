"""Runs for other programs: VTKHDF files for ParaView, tables, labelled arrays. A kind is a file of this room."""
