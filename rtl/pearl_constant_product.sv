// SPDX-License-Identifier: MIT
// The low half of the product with a constant, from partial products that fit a multiplier each, and are added
// behind it. There is a register on either side of a multiplier: it may be far away.
module pearl_constant_product #(
    parameter logic [31:0] FACTOR = 32'h7FEB_352D
) (
    input  logic        clk_i,
    input  logic [31:0] x_i,
    // Four cycles later.
    output logic [31:0] product_o
);

  logic [31:0] x_q, low_q, partial_q, product_q;
  logic [15:0] high_low_q, low_high_q, rest_q;

  always_ff @(posedge clk_i) begin
    x_q        <= x_i;
    low_q      <= 32'(x_q[15:0]) * 32'(FACTOR[15:0]);
    high_low_q <= 16'(32'(x_q[31:16]) * 32'(FACTOR[15:0]));
    low_high_q <= 16'(32'(x_q[15:0]) * 32'(FACTOR[31:16]));
  end

  // One sum a cycle: two in a row and the way from the multipliers are what limits a clock.
  always_ff @(posedge clk_i) begin
    partial_q <= {low_q[31:16] + high_low_q, low_q[15:0]};
    rest_q    <= low_high_q;
    product_q <= {partial_q[31:16] + rest_q, partial_q[15:0]};
  end
  assign product_o = product_q;

endmodule
