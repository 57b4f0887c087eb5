// A polynomial by Horner's rule, each step a rounded product by x and the next coefficient on top:
// ((COEFFICIENTS[STEPS] x + COEFFICIENTS[STEPS-1]) x + ...) x + COEFFICIENTS[0], in words of
// pearl_fixed_pkg::FRACTION fraction bits.
//
// Latency STEPS * pearl_fixed_pkg::MULTIPLY_LATENCY.
module pearl_horner
  import pearl_fixed_pkg::*;
#(
    parameter int unsigned                 STEPS        = 1,
    parameter logic        [STEPS:0][31:0] COEFFICIENTS = '0
) (
    input  logic   clk_i,
    input  fixed_t x_i,
    output fixed_t y_o
);

  fixed_t [STEPS-1:0] x;
  fixed_t [  STEPS:0] y;

  assign x[0] = x_i;
  assign y[0] = COEFFICIENTS[STEPS];
  assign y_o  = y[STEPS];

  for (genvar i = 0; i < STEPS; i++) begin : gen_step
    if (i > 0) begin : gen_wait
      pearl_delay #(
          .WIDTH (32),
          .STAGES(MULTIPLY_LATENCY)
      ) u_delay (
          .clk_i,
          .d_i(x[i-1]),
          .d_o(x[i])
      );
    end
    pearl_fixed_multiply #(
        .SHIFT (FRACTION),
        .ADDEND(COEFFICIENTS[STEPS-1-i])
    ) u_multiply (
        .clk_i,
        .a_i(x[i]),
        .b_i(y[i]),
        .product_o(y[i+1])
    );
  end

endmodule
