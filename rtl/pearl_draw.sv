// SPDX-License-Identifier: MIT
// The random draw of a slot under the keys of a step (`draw` of pearl_marl/golden/rng.py): one a cycle,
// DRAW_LATENCY cycles after its slot number.
module pearl_draw
  import pearl_pkg::*;
(
    input  logic        clk_i,
    input  logic [31:0] slot_i,
    input  logic [31:0] key_a_i,
    input  logic [31:0] key_b_i,
    output logic [31:0] draw_o
);

  logic [31:0] first_q, second_q, draw_q, first_product, second_product;

  pearl_constant_product #(
      .FACTOR(MULTIPLIER_1)
  ) u_first (
      .clk_i,
      .x_i      (first_q),
      .product_o(first_product)
  );
  pearl_constant_product #(
      .FACTOR(MULTIPLIER_2)
  ) u_second (
      .clk_i,
      .x_i      (second_q),
      .product_o(second_product)
  );

  always_ff @(posedge clk_i) begin
    first_q  <= fold(slot_i ^ key_a_i, 16);
    second_q <= fold(first_product ^ key_b_i, 15);
    draw_q   <= fold(second_product, 16);
  end

  assign draw_o = draw_q;

endmodule
