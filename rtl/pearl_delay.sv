// SPDX-License-Identifier: MIT
// A value, a fixed number of cycles later. No reset, so that long delays become shift-register LUTs.
module pearl_delay #(
    parameter int unsigned WIDTH  = 1,
    // 0 is a wire.
    parameter int unsigned STAGES = 1
) (
    input  logic             clk_i,
    input  logic [WIDTH-1:0] d_i,
    output logic [WIDTH-1:0] d_o
);

  if (STAGES == 0) begin : gen_wire
    logic unused_clk;
    assign unused_clk = clk_i;
    assign d_o = d_i;
  end else begin : gen_stages
    // A signal a stage: of one array of them all, Verilator makes several times as much code.
    for (genvar i = 0; i < STAGES; i++) begin : gen_stage
      logic [WIDTH-1:0] value_q;
      if (i == 0) begin : gen_first
        always_ff @(posedge clk_i) value_q <= d_i;
      end else begin : gen_next
        always_ff @(posedge clk_i) value_q <= gen_stage[i-1].value_q;
      end
    end
    assign d_o = gen_stage[STAGES-1].value_q;
  end

endmodule
