"""The look of bodies, and MuJoCo's renderer that draws them."""
