"""How bodies look, and MuJoCo's renderer that draws them."""
