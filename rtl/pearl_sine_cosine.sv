// Sine and cosine of an angle in fractions of a turn (`sine_cosine` of pearl_marl/fixed_point.py,
// which says where the coefficients come from).
//
// Latency pearl_fixed_pkg::SINE_COSINE_LATENCY.
module pearl_sine_cosine
  import pearl_fixed_pkg::*;
(
    input  logic          clk_i,
    input  logic   [31:0] turns_i,
    output fixed_t        sine_o,
    output fixed_t        cosine_o
);

  // Turned by an eighth, so that the two upper bits are the quadrant and the others, their sign
  // inverted, are the distance from its middle.
  logic [31:0] turned_q;
  fixed_t eighths;

  always_ff @(posedge clk_i) turned_q <= turns_i + 32'h20000000;

  assign eighths = {{2{~turned_q[29]}}, turned_q[28:0], 1'b0};

  fixed_t square, factor, factor_eighths, sine, cosine;

  pearl_fixed_multiply #(
      .SHIFT(FRACTION)
  ) u_square (
      .clk_i,
      .a_i(eighths),
      .b_i(eighths),
      .product_o(square)
  );

  pearl_horner #(
      .STEPS(3),
      .COEFFICIENTS({-32'sd38523, 32'sd2673479, -32'sd86699678, 32'sd843314845})
  ) u_factor (
      .clk_i,
      .x_i(square),
      .y_o(factor)
  );

  pearl_delay #(
      .WIDTH (32),
      .STAGES(4 * MULTIPLY_LATENCY)
  ) u_eighths (
      .clk_i,
      .d_i(eighths),
      .d_o(factor_eighths)
  );

  pearl_fixed_multiply #(
      .SHIFT(FRACTION)
  ) u_sine (
      .clk_i,
      .a_i(factor_eighths),
      .b_i(factor),
      .product_o(sine)
  );

  pearl_horner #(
      .STEPS(4),
      .COEFFICIENTS({32'sd3792, -32'sd349977, 32'sd17023455, -32'sd331168968, ONE})
  ) u_cosine (
      .clk_i,
      .x_i(square),
      .y_o(cosine)
  );

  // In odd quadrants the two change places; the signs are those of the quadrant.
  logic [1:0] quadrant;
  pearl_delay #(
      .WIDTH (2),
      .STAGES(5 * MULTIPLY_LATENCY)
  ) u_quadrant (
      .clk_i,
      .d_i(turned_q[31:30]),
      .d_o(quadrant)
  );

  fixed_t plain_sine, plain_cosine, sine_q, cosine_q;
  assign plain_sine   = quadrant[0] ? cosine : sine;
  assign plain_cosine = quadrant[0] ? sine : cosine;

  always_ff @(posedge clk_i) begin
    sine_q   <= quadrant[1] ? -plain_sine : plain_sine;
    cosine_q <= ^quadrant ? -plain_cosine : plain_cosine;
  end

  assign sine_o   = sine_q;
  assign cosine_o = cosine_q;

endmodule
