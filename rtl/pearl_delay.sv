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
    logic [STAGES-1:0][WIDTH-1:0] stages_q;
    always_ff @(posedge clk_i) begin
      stages_q[0] <= d_i;
      for (int unsigned i = 1; i < STAGES; i++) stages_q[i] <= stages_q[i-1];
    end
    assign d_o = stages_q[STAGES-1];
  end

endmodule
