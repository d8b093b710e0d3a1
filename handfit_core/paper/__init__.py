"""The paper's method: "Monocular 3D Hand Pose Estimation with Implicit Camera Alignment"
(arXiv 2506.11133), its experiments A to H, and `paper-a-plus`, which is made of A. Needs torch."""
