// The reset of a board's design: falls at once, rises with the clock, and lasts as long as the
// pipeline takes to drain.
module pearl_reset (
    input  logic clk_i,
    // The clock can be used; may come and go at any time.
    input  logic ready_i,
    output logic rst_no
);

  // pearl_backbone asks for LATENCY + 4 cycles.
  localparam int unsigned CYCLES = pearl_core_pkg::LATENCY + 4;
  localparam int unsigned COUNT_BITS = $clog2(CYCLES + 1);

  (* ASYNC_REG = "TRUE" *) logic [1:0] ready_q;
  logic [COUNT_BITS-1:0] count_q;
  logic rst_nq;

  always_ff @(posedge clk_i or negedge ready_i) begin
    if (!ready_i) begin
      ready_q <= '0;
      count_q <= '0;
      rst_nq  <= 1'b0;
    end else begin
      ready_q <= {ready_q[0], 1'b1};
      if (ready_q[1] && 32'(count_q) != CYCLES) count_q <= count_q + 1'b1;
      rst_nq <= 32'(count_q) == CYCLES;
    end
  end

  assign rst_no = rst_nq;

endmodule
