// 1 / x for x from 1 to just below 2 (`reciprocal` of pearl_marl/fixed_point.py): a parabola, then two
// of Newton's refinements.
//
// Latency pearl_fixed_pkg::RECIPROCAL_LATENCY.
module pearl_reciprocal
  import pearl_fixed_pkg::*;
(
    input  logic   clk_i,
    input  fixed_t x_i,
    output fixed_t reciprocal_o
);

  localparam int unsigned REFINEMENTS = 2;

  // Before each refinement, r also after the last.
  fixed_t [REFINEMENTS-1:0] x;
  fixed_t [  REFINEMENTS:0] r;

  pearl_horner #(
      .STEPS(2),
      .COEFFICIENTS({32'sd347068064, -32'sd867670161, 32'sd1062895947})
  ) u_parabola (
      .clk_i,
      .x_i(x_i - ONE),
      .y_o(r[0])
  );

  pearl_delay #(
      .WIDTH (32),
      .STAGES(2 * MULTIPLY_LATENCY)
  ) u_x (
      .clk_i,
      .d_i(x_i),
      .d_o(x[0])
  );

  for (genvar i = 0; i < REFINEMENTS; i++) begin : gen_refine
    fixed_t product, r_early, r_late, correction;

    pearl_fixed_multiply #(
        .SHIFT(FRACTION)
    ) u_product (
        .clk_i,
        .a_i(x[i]),
        .b_i(r[i]),
        .product_o(product)
    );
    pearl_delay #(
        .WIDTH (32),
        .STAGES(MULTIPLY_LATENCY)
    ) u_early (
        .clk_i,
        .d_i(r[i]),
        .d_o(r_early)
    );
    pearl_fixed_multiply #(
        .SHIFT(FRACTION)
    ) u_correction (
        .clk_i,
        .a_i(r_early),
        .b_i(ONE - product),
        .product_o(correction)
    );
    pearl_delay #(
        .WIDTH (32),
        .STAGES(MULTIPLY_LATENCY)
    ) u_late (
        .clk_i,
        .d_i(r_early),
        .d_o(r_late)
    );
    if (i + 1 < REFINEMENTS) begin : gen_next
      pearl_delay #(
          .WIDTH (32),
          .STAGES(2 * MULTIPLY_LATENCY)
      ) u_x (
          .clk_i,
          .d_i(x[i]),
          .d_o(x[i+1])
      );
    end
    assign r[i+1] = r_late + correction;
  end

  fixed_t reciprocal_q;
  always_ff @(posedge clk_i) reciprocal_q <= r[REFINEMENTS];

  assign reciprocal_o = reciprocal_q;

endmodule
