// A plate 0.6 by 0.1 m with a web 0.04 m deep under its middle: gmsh -2 stiffened_panel.geo
size = 0.02;
Point(1) = {0, -0.05, 0, size};    Point(2) = {0.6, -0.05, 0, size};
Point(3) = {0, 0, 0, size};        Point(4) = {0.6, 0, 0, size};
Point(5) = {0, 0.05, 0, size};     Point(6) = {0.6, 0.05, 0, size};
Point(7) = {0, 0, -0.04, size};    Point(8) = {0.6, 0, -0.04, size};
Line(1) = {1, 2};  Line(2) = {3, 4};  Line(3) = {5, 6};  Line(4) = {7, 8};
Line(5) = {1, 3};  Line(6) = {2, 4};  Line(7) = {3, 5};  Line(8) = {4, 6};  Line(9) = {7, 3};  Line(10) = {8, 4};
Curve Loop(1) = {1, 6, -2, -5};  Plane Surface(1) = {1};
Curve Loop(2) = {2, 8, -3, -7};  Plane Surface(2) = {2};
Curve Loop(3) = {4, 10, -2, -9}; Plane Surface(3) = {3};
Physical Surface("skin") = {1, 2};
Physical Surface("web") = {3};
Physical Curve("root") = {5, 7, 9};
Physical Curve("tip") = {6, 8, 10};
