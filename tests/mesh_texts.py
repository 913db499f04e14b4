"""Mesh files as text, small: of gmsh, Abaqus, Nastran, VTK and OBJ, with sets; how they are written and sets read."""

GMSH22 = """$MeshFormat
2.2 0 8
$EndMeshFormat
$PhysicalNames
3
0 1 "a"
1 1 "a"
2 1 "a"
$EndPhysicalNames
$Nodes
5
1 0 0 0
2 1 0 0
3 1 1 0
7 0 1 0
9 5 5 5
$EndNodes
$Elements
6
1 15 2 1 1 2
2 1 2 1 1 1 7
3 2 2 1 1 1 2 3
4 2 2 2 1 1 3 7
5 15 2 2 1 3
6 1 2 2 1 2 3
$EndElements
"""

INP = """*HEADING
** written by hand
*NODE, NSET=Every
 10, 0., 0., 0.
 20, 1., 0., 0.
 30, 1., 1.
** a comment between data lines
 40, 0., 1.
 50, 2.
 60, 2., 1.
 99, 9., 9., 9.
*ELEMENT, TYPE=S3R, ELSET=Tri
1, 10, 20, 30
2, 10, 30, 40
*Element, type=S4,
 elset=Quad
7, 20, 50, 60, 30
*ELSET, ELSET=all
 tri, QUAD
*ELSET, ELSET=odd, GENERATE
1, 7, 2
3, 3
*NSET, NSET=left
 10, 40
*NSET, NSET=LEFT
 99
*NSET, NSET=ofquad, ELSET=Quad
*SURFACE, NAME=rim
Quad, E2
2, E3
*SURFACE, NAME=top, TYPE=ELEMENT
Tri, SPOS
*SURFACE, NAME=points, TYPE=NODE
left
"""

PARTS = """*Part, name=Plate
*Node
1, 0., 0., 0.
2, 1., 0., 0.
3, 1., 1., 0.
*Element, type=S3
1, 1, 2, 3
*Nset, nset=Set-1, generate
1, 2, 1
*Elset, elset=Skin
1
*Shell Section, elset=Skin, material=Steel
0.1, 5
*End Part
*Assembly, name=Assembly
*Instance, name=First, part=Plate
*End Instance
*Instance, name=Second, part=Plate
1., 1., 5.
1., 1., 5., 1., 1., 6., 90.
*End Instance
*Nset, nset=Set-1, instance=Second
3
*Elset, elset=_Loaded_SPOS, internal, instance=Second
1
*Surface, type=ELEMENT, name=Loaded
_Loaded_SPOS, SPOS
*Nset, nset=Both
First.Set-1, Second.3
*End Assembly
"""

BDF = """SOL 101
CEND
BEGIN BULK
$HMNAME PROP         4"skin" 4
GRID           1              0.      0.      0.
GRID,2,,1.0,0.0,0.0
GRID*                  3                             1.0             1.0
*                    0.0
GRID           4       7     1.0     90.      0.
CORD2C  7               0.      0.      0.      0.      0.      1.      +
+       1.      0.      0.
GRID           5         2.+0       0.      0.
GRID           6             2.0     1.0     0.0
CTRIA3         1       4       1       2       3      30.     0.1
CTRIA3,2,4,1,3,4
CQUAD4         3       9       2       5       6       3     45.
CBAR           8       5       5       6     0.0     0.0     1.0
PSHELL         4       1     0.1
PCOMP          9
ENDDATA
"""

POLYDATA = """# vtk DataFile Version 3.0
written by hand
ASCII
DATASET POLYDATA
POINTS 6 float
0 0 0 1 0 0 1 1 0
0 1 0 2 0 0 2 1 0
POLYGONS 3 13
3 0 1 2
3 0 2 3
4 1 4 5 2
CELL_DATA 3
SCALARS part int 1
LOOKUP_TABLE default
1 1 2
NORMALS Normals float
0 0 1 0 0 1 0 0 1
POINT_DATA 6
SCALARS number int
LOOKUP_TABLE default
0 1 2 3 4 5
"""

OBJ = """# written by hand
o Wing
v 0 0 0 0.5 0.5 0.5
v 1 0 0
v 1 1 0
v 0 1 0
g skin upper
f 1/1 2/2 3/3
f 1 -2 -1
v 2 0 0
v 2 1 0
g rib
f 2//1 5//1 6//1 3//1
"""


def written(folder, name: str, text: str):
    (folder / name).write_text(text)
    return folder / name


def lists(sets) -> dict:
    return {name: numbers.tolist() for name, numbers in sets.items()}
