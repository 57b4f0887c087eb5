// Fixed-point arithmetic for cores: the number and the latencies of the modules that reckon with it.
package pearl_fixed_pkg;

  // No core uses all of it.
  // verilator lint_off UNUSEDPARAM

  // A word of pearl_marl/fixed_point.py. Where its binary point stands, its user knows.
  typedef logic signed [31:0] fixed_t;

  // Cycles from an input to its result. All of them take an input every cycle.
  localparam int unsigned MULTIPLY_LATENCY = 3;
  localparam int unsigned SINE_COSINE_LATENCY = 5 * MULTIPLY_LATENCY + 2;
  localparam int unsigned RECIPROCAL_LATENCY = 6 * MULTIPLY_LATENCY + 1;

  // -1 to 1, as sines, cosines and reciprocals are.
  localparam int unsigned FRACTION = 30;
  localparam fixed_t ONE = 32'sd1 << FRACTION;

  localparam fixed_t MAXIMUM = 32'sh7fffffff;
  localparam fixed_t MINIMUM = 32'sh80000000;

  // verilator lint_on UNUSEDPARAM

  // The nearest word to a sum (`saturating_add` of fixed_point.py).
  function automatic fixed_t saturate(logic signed [32:0] sum);
    // Outside if the sum's sign is not that of the 32 bits below it.
    if (sum[32] == sum[31]) return sum[31:0];
    return sum[32] ? MINIMUM : MAXIMUM;
  endfunction

endpackage
