// SPDX-License-Identifier: MIT
// The sum of signed numbers by a tree of adders, a level a cycle.
module pearl_sum
  import pearl_pkg::ceil_div;
#(
    parameter  int unsigned TERMS  = 4,
    parameter  int unsigned WIDTH  = 16,
    localparam int unsigned LEVELS = $clog2(TERMS)
) (
    input  logic                               clk_i,
    input  logic [       TERMS-1:0][WIDTH-1:0] terms_i,
    // LEVELS cycles later.
    output logic [WIDTH+LEVELS-1:0]            sum_o
);

  if (LEVELS == 0) begin : gen_wire
    logic unused_clk;
    assign unused_clk = clk_i;
    assign sum_o = terms_i;
  end else begin : gen_levels
    for (genvar i = 0; i < LEVELS; i++) begin : gen_level
      localparam int unsigned INPUTS = ceil_div(TERMS, 1 << i);
      localparam int unsigned BITS = WIDTH + i;
      logic [INPUTS-1:0][BITS-1:0] terms;
      logic [ceil_div(INPUTS, 2)-1:0][BITS:0] sums_q;
      if (i == 0) begin : gen_first
        assign terms = terms_i;
      end else begin : gen_next
        assign terms = gen_level[i-1].sums_q;
      end
      always_ff @(posedge clk_i) begin
        for (int unsigned k = 0; k < INPUTS / 2; k++) begin
          sums_q[k] <= (BITS + 1)'($signed(terms[2*k])) + (BITS + 1)'($signed(terms[2*k+1]));
        end
      end
      if (INPUTS % 2 == 1) begin : gen_odd
        always_ff @(posedge clk_i) sums_q[INPUTS/2] <= (BITS + 1)'($signed(terms[INPUTS-1]));
      end
    end
    assign sum_o = gen_level[LEVELS-1].sums_q;
  end

endmodule
