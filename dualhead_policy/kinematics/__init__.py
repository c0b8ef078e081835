"""Forward kinematics: differentiable maps from head A's space to the position."""
