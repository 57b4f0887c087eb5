// A product, rounded: (a * b + half) >> SHIFT, and ADDEND on top (`multiply` of
// pearl_marl/fixed_point.py).
//
// Latency pearl_fixed_pkg::MULTIPLY_LATENCY. Operands are split into halves here, not by the
// synthesiser, so that each partial product has registers before and behind it within one DSP block
// (18 by 18 bits suffice), and the only long carry chain is that of the last stage.
module pearl_fixed_multiply
  import pearl_fixed_pkg::fixed_t;
#(
    parameter int unsigned SHIFT  = 30,
    // Costs nothing: it takes part in the sum as the half does.
    parameter fixed_t      ADDEND = '0
) (
    input  logic   clk_i,
    input  fixed_t a_i,
    input  fixed_t b_i,
    output fixed_t product_o
);

  if (SHIFT < 1 || SHIFT > 62) begin : gen_illegal_shift
    $error("SHIFT is %0d; possible are 1 to 62", SHIFT);
  end
  if (ADDEND != 0 && SHIFT > 32) begin : gen_illegal_addend
    $error("SHIFT is %0d; an ADDEND would lose its upper bits beyond 32", SHIFT);
  end

  localparam logic signed [63:0] OFFSET = (64'(ADDEND) << SHIFT) + (64'sd1 << (SHIFT - 1));

  fixed_t a_q, b_q, product_q;
  // Upper halves are signed, lower halves are not: 17 bits hold either.
  logic signed [16:0] a_high, a_low, b_high, b_low;
  logic signed [33:0] high_q, middle_0_q, middle_1_q, low_q;
  logic signed [63:0] sum;

  assign a_high = {a_q[31], a_q[31:16]};
  assign a_low = {1'b0, a_q[15:0]};
  assign b_high = {b_q[31], b_q[31:16]};
  assign b_low = {1'b0, b_q[15:0]};
  assign sum = {high_q[31:0], low_q[31:0]} + (64'(middle_0_q) <<< 16) + (64'(middle_1_q) <<< 16) + OFFSET;

  always_ff @(posedge clk_i) begin
    a_q        <= a_i;
    b_q        <= b_i;

    high_q     <= a_high * b_high;
    middle_0_q <= a_high * b_low;
    middle_1_q <= a_low * b_high;
    low_q      <= a_low * b_low;

    product_q  <= 32'(sum >>> SHIFT);
  end

  assign product_o = product_q;

  // The upper partial products fit 32 bits.
  logic unused_signs;
  assign unused_signs = ^{high_q[33:32], low_q[33:32]};

endmodule
