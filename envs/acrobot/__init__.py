"""Acrobot: swing two links up by a torque at the joint between them."""
